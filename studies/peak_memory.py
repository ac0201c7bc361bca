"""The peak memory of this process; only Linux tells that of this program alone, and counts it anew."""

import resource
import sys
from pathlib import Path


def reset_peak_memory() -> None:
    """Let the system count the peak memory anew."""
    if (place := Path("/proc/self/clear_refs")).exists():
        place.write_text("5")


def read_peak_memory_mb() -> float:
    """Largest resident memory of this process, MB; ru_maxrss starts from the parent's, which exec does not reset."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    peaks = [float(line.split()[1]) for line in lines if line.startswith("VmHWM")]
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return 1.024e-3 * peaks[0] if peaks else largest / 1e6 if sys.platform == "darwin" else 1.024e-3 * largest
