"""`python -m holdfast_check FILE`."""

from holdfast_check import main

if __name__ == "__main__":
    main()
