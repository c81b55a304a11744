"""Pages for a browser (Plotly, Jinja)."""
