"""Work in other threads, processes and machines, and how long it takes."""
