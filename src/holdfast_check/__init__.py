"""A checker of certificates, in balls of a maintained library; it shares no code with holdfast."""
