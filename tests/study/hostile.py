"""Methods that do what no method should, each in its own way; they say what became of them."""

import _thread
import ctypes
import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
import warnings
from types import SimpleNamespace

import numpy as np

from tvsysid import DataQualityWarning
from tvsysid.estimates import Estimate
from tvsysid.models import Diagnostics, Model


def found(ensemble, stiffness=None, torque=None):
    """A model that is none the worse for what its method did."""
    known = 100.0 * ensemble.angle[:, ensemble.core]
    values = np.full(ensemble.samples, 100.0) if stiffness is None else stiffness
    return SimpleNamespace(stiffness=values, predict=lambda _: known if torque is None else torque(known))


class SetsFlags:
    """Writes to the data, after it has made them writeable."""

    def identify(self, ensemble):
        values = ensemble.torque
        while values.base is not None:
            values = values.base
        values.setflags(write=True)
        values *= 3.0
        return found(ensemble)


class WritesMemory:
    def identify(self, ensemble):
        ctypes.memset(ensemble.angle.ctypes.data, 0, ensemble.angle.nbytes)
        return found(ensemble)


class SetsAttribute:
    def identify(self, ensemble):
        object.__setattr__(ensemble, "torque", -ensemble.torque)
        return found(ensemble)


class Hangs:
    def identify(self, ensemble):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(60)


class HangsInNativeCode:
    """Never returns to Python, and keeps the interpreter's lock."""

    def identify(self, ensemble):
        ctypes.PyDLL(None).sleep(600)


class HangsWhenAsked:
    def identify(self, ensemble):
        return found(ensemble, torque=lambda known: time.sleep(600))


class LeavesThread:
    def identify(self, ensemble):
        threading.Thread(target=time.sleep, args=(600,), daemon=False).start()
        return found(ensemble)


class LeavesFork:
    """Comes back twice, and once more in a program of its own."""

    def identify(self, ensemble):
        subprocess.Popen(["sleep", "600"])
        os.fork()
        return found(ensemble)


class Crashes:
    def identify(self, ensemble):
        os.kill(os.getpid(), signal.SIGSEGV)


class Interrupts:
    def identify(self, ensemble):
        raise KeyboardInterrupt


class InterruptsMain:
    def identify(self, ensemble):
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _thread.interrupt_main()
        time.sleep(5)


class LeavesGenerator:
    def identify(self, ensemble):
        raise GeneratorExit


class Exits:
    def identify(self, ensemble):
        sys.exit(0)


class UnreadableError(Exception):
    def __str__(self):
        raise KeyboardInterrupt


class RaisesUnreadable:
    def identify(self, ensemble):
        raise UnreadableError


class RaisesMegabyte:
    def identify(self, ensemble):
        raise ValueError("\x1b[2J\x00 too much" * 100_000)


class GivesComplex:
    def identify(self, ensemble):
        return found(ensemble, np.full(ensemble.samples, 100 + 1j))


class GivesText:
    def identify(self, ensemble):
        return found(ensemble, np.full(ensemble.samples, "100"))


class GivesInfinity:
    def identify(self, ensemble):
        return found(ensemble, np.r_[np.inf, np.full(ensemble.samples - 1, 100.0)])


class GivesMasked:
    def identify(self, ensemble):
        return found(ensemble, np.ma.masked_less(np.arange(float(ensemble.samples)), 50))


class GivesTooMany:
    def identify(self, ensemble):
        return found(ensemble, np.broadcast_to(100.0, 10**12))


class GivesLazy:
    def identify(self, ensemble):
        return found(ensemble, Lazy())


class Lazy:
    shape = (200,)

    def __array__(self, *given, **named):
        raise RuntimeError("the cluster is gone")


class PredictsInfinity:
    def identify(self, ensemble):
        return found(ensemble, torque=lambda known: known + np.inf)


class Rotated(Model):
    """A model of the package's own kind, but for its torque."""

    def _pathways(self, ensemble):
        return {"intrinsic": 1j * ensemble.torque[:, ensemble.core]}


class PredictsComplex:
    def identify(self, ensemble):
        stiffness = {"stiffness": Estimate(np.full(ensemble.samples, 100.0), "N m/rad")}
        about = {"diagnostics": Diagnostics(1.0), "sampling_rate": ensemble.sampling_rate, "time": ensemble.time}
        return Rotated(method="own", estimates=stiffness, **about)


class HasNoPathways:
    def identify(self, ensemble):
        return SimpleNamespace(stiffness=np.full(ensemble.samples, 100.0), pathways=lambda _: {})


class GivesHuge:
    """Its square overflows."""

    def identify(self, ensemble):
        return found(ensemble, np.full(ensemble.samples, 1e200))


class TakesAllMemory:
    def identify(self, ensemble):
        np.empty(resource.getrlimit(resource.RLIMIT_DATA)[0], np.uint8)


class WarnsAtEachSample:
    def identify(self, ensemble):
        for number in range(20_000):
            warnings.warn(f"singular at sample {number}", DataQualityWarning, stacklevel=1)
        return found(ensemble)


class ChangesEverything:
    """Leaves the process, NumPy and the package as nobody wants them; its own result is as good as any."""

    def identify(self, ensemble):
        import tvsysid
        from tvsysid.methods import apply

        model = found(ensemble)
        os.chdir("/")
        os.environ.clear()
        np.seterr(all="raise")
        np.random.seed(0)  # noqa: NPY002
        random.seed(0)
        warnings.simplefilter("error")
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        sys.stdout.close()
        np.linalg.solve = np.linalg.lstsq = np.linalg.svd = np.fft.rfft = np.multiply = None
        tvsysid.methods.sds.ShortDataSegments.identify = apply.apply = None
        return model


FAILURES = {
    SetsFlags: "it changed the ensemble, which must stay as it is",
    WritesMemory: "it changed the ensemble, which must stay as it is",
    SetsAttribute: "it changed the ensemble, which must stay as it is",
    Hangs: "it took longer than the time limit of",
    HangsInNativeCode: "it took longer than the time limit of",
    HangsWhenAsked: "it took longer than the time limit of",
    Crashes: "its process ended without a result",
    Interrupts: "KeyboardInterrupt (hostile.py, line",
    InterruptsMain: "KeyboardInterrupt",
    LeavesGenerator: "GeneratorExit (hostile.py, line",
    Exits: "SystemExit: 0 (hostile.py, line",
    RaisesUnreadable: "UnreadableError: its text cannot be read",
    RaisesMegabyte: r"ValueError: \x1b[2J\x00 too much\x1b[2J\x00 too much",
    GivesComplex: "expected real numbers, got values of type complex128",
    GivesText: "expected real numbers, got values of type <U3",
    GivesInfinity: "some of them infinite; give NaN where nothing can be said",
    GivesMasked: "got a masked array; fill what is masked with NaN",
    GivesTooMany: "the model's stiffness must be of shape (200,), it is (1000000000000,)",
    GivesLazy: "the cluster is gone",
    PredictsInfinity: "some of them infinite; give NaN where nothing can be said",
    PredictsComplex: "expected real numbers, got values of type complex128",
    HasNoPathways: "must be a mapping of the torque of each pathway by its name, got none",
    GivesHuge: "the model's stiffness: expected values up to 1e+150, got 1e+200",
    TakesAllMemory: "MemoryError: Unable to allocate",
}
"""What is said of each that fails."""
HARMLESS = (LeavesThread, LeavesFork, WarnsAtEachSample, ChangesEverything)
"""Those that give a result, whatever else they do."""
