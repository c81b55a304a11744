"""Where users live: each module here needs one library more, `pip install holdfast[interop]`."""
