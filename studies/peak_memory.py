"""The peak memory of this process; only Linux reports that of this program alone, and can reset it."""

import resource
import sys
from pathlib import Path


def reset_peak_memory() -> None:
    """Reset the system's record of the peak memory."""
    if (path := Path("/proc/self/clear_refs")).exists():
        path.write_text("5")


def read_peak_memory_mb() -> float:
    """Read the largest resident memory of this process, MB; ru_maxrss includes the parent's, which exec keeps."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    peaks = [float(line.split()[1]) for line in lines if line.startswith("VmHWM")]
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return 1.024e-3 * peaks[0] if peaks else largest / 1e6 if sys.platform == "darwin" else 1.024e-3 * largest
