"""Claims of the thesis as data, judged, and the report on them."""
