"""Ctrl-C while the program `voxflat` is still being imported ends it without a traceback; scripts are left alone.

It is imported first, and `voxflat.cli` takes Ctrl-C over once it can tidy up.
"""

import signal
import sys
import threading
from pathlib import Path

_NAMES = (sys.argv[0], *sys.orig_argv[1:3]) if hasattr(sys, "argv") and sys.argv else ()

if (
    (Path((*_NAMES, "")[0]).stem == "voxflat" or _NAMES[1:] == ("-m", "voxflat.cli"))
    and threading.current_thread() is threading.main_thread()
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def take_over() -> None:
    """Let Ctrl-C be `KeyboardInterrupt` again."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
