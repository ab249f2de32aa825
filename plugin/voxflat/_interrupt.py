"""Ctrl-C while the program `voxflat` is still being imported ends it without a traceback; scripts are left alone.

It is imported first, itself imports nothing that Python has not at its start (`signal` brings in `enum`, for some ms),
and `voxflat.cli` takes Ctrl-C over once it can tidy up.
"""

import _signal  # type: ignore[import-not-found]  # the C part of `signal`
import os
import sys


def _exchange(now: object, then: object) -> None:
    """Let another answer to Ctrl-C take the place of one, if that is what there is."""
    if _signal.getsignal(_signal.SIGINT) == now:
        try:  # noqa: SIM105  (contextlib would have to be imported)
            _signal.signal(_signal.SIGINT, then)
        except ValueError:  # another thread than the first has no say
            pass


_NAMES = (sys.argv[0], *sys.orig_argv[1:3]) if hasattr(sys, "argv") and sys.argv else ()

if os.path.splitext(os.path.basename((*_NAMES, "")[0]))[0] == "voxflat" or _NAMES[1:] == ("-m", "voxflat.cli"):
    _exchange(_signal.default_int_handler, _signal.SIG_DFL)


def take_over() -> None:
    """Let Ctrl-C be `KeyboardInterrupt` again."""
    _exchange(_signal.SIG_DFL, _signal.default_int_handler)
