"""Interfaces to other libraries; each module needs an optional one (`holdfast[interop]`)."""
