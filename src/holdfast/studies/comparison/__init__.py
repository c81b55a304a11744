"""One scenario beside others; a closed loop beside a kernel."""
