import os
import signal

os.environ.setdefault("MPLBACKEND", "Agg")

# a shell's background jobs, and what they start, ignore Ctrl-C: tests that press it would wait for ever
signal.signal(signal.SIGINT, signal.default_int_handler)
