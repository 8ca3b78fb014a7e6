"""A session's photographs to results: `labkit fit`, in the order of its steps."""
