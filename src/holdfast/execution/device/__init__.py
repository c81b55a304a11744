"""Programs for a graphics processor, and the same text compiled by a C++ compiler."""
