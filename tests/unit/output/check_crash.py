"""Kill a writer at random moments, and let it run into a full disk: every committed frame must still be readable.

python3 check_crash.py WRITER [kills [launcher of several ranks, of which one is killed]]
"""
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time

import h5py
import numpy as np


def read_frames(path, n, changing):
    """Frames and history rows in the file; raises unless each holds what the writer put there"""
    with h5py.File(path, "r") as file:
        root = file["VTKHDF"]
        steps = root["Steps"]
        frames = int(steps.attrs["NSteps"])
        assert all(len(steps[k]) >= frames for k in steps), "a table of steps is too short"
        for k in range(frames):
            frame = k + 1
            m = n + changing * ((7 * frame) % 5)
            part, first = int(steps["PartOffsets"][k]), int(steps["PointOffsets"][k])
            assert int(root["NumberOfPoints"][part]) == m, "number of points"
            assert steps["Values"][k] == 0.25 * frame, "time"
            expected = {"Points": frame, "PointData/velocity": -frame, "PointData/pressure": 0.5 * frame + 1 + np.arange(m)}
            for name, value in expected.items():
                rows = root[name][first:first + m]
                assert len(rows) == m and (rows == value).all(), f"{name} of frame {frame}"
            ids = root["PointData/id"][first:first + m]
            assert (ids == 1000 * frame + 1 + np.arange(m)).all(), f"id of frame {frame}"
            cell = int(steps["CellOffsets"][k, 0]) + part  # Offsets has one entry more than cells in every part
            assert (root["Vertices/Offsets"][cell:cell + m + 1] == np.arange(m + 1)).all(), "offsets of cells"
            assert (root["Vertices/Connectivity"][:m] == np.arange(m)).all(), "connectivity"
        rows = int(file["history"].attrs["rows"])
        for name, factor in (("frame", 1.0), ("half", 0.5)):
            assert (file["history"][name][:rows] == factor * (1 + np.arange(rows) // 3)).all(), f"history {name}"
        assert file["scene/input"][()] == b"as read", "scene"
    return frames, rows


def frames_told(log):
    words = open(log).read().split("\n")[:-1]  # the last line may be cut
    return int(words[-1]) if words else 0


def check(path, log, n, changing):
    told = frames_told(log)
    if not os.path.exists(path):
        assert told == 0, f"no file, though {told} frames were committed"
        return 0
    frames, rows = read_frames(path, n, changing)
    assert frames >= told, f"{frames} frames, though {told} were committed"
    assert rows >= 3 * told, f"{rows} rows of history, though {3 * told} were committed"
    return frames


def a_rank(launcher, writer):
    """One of the processes that a launcher has started; None when there is none"""
    ranks = []
    for number in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{number}/stat") as stat, open(f"/proc/{number}/cmdline") as words:
                parent = int(stat.read().rpartition(")")[2].split()[1])
                if parent == launcher and words.read().split("\0")[0] == writer:
                    ranks.append(int(number))
        except (FileNotFoundError, ProcessLookupError):
            continue
    return random.choice(ranks) if ranks else None


def kill(process, launcher, writer, log):
    """Kill a writer at a random moment; of several ranks only one, the launcher then ends the others"""
    if not launcher:
        time.sleep(0.02 + 0.3 * random.random())
        process.send_signal(signal.SIGKILL)
        return
    until = time.monotonic() + 30
    while frames_told(log) == 0 and time.monotonic() < until:  # until all ranks have come together
        time.sleep(0.02)
    time.sleep(0.3 * random.random())
    victim = a_rank(process.pid, writer)
    assert victim, "no rank is running"
    os.kill(victim, signal.SIGKILL)


def main():
    writer = os.path.abspath(sys.argv[1])
    kills = int(sys.argv[2]) if len(sys.argv) > 2 else 10
    launcher = sys.argv[3:]
    most = 0
    with tempfile.TemporaryDirectory() as folder:
        path, log = os.path.join(folder, "run.vtkhdf"), os.path.join(folder, "log")
        for k in range(kills):
            n, changing = random.choice((3, 700, 20000)), k % 2
            for old in (path, path + ".part"):
                if os.path.exists(old):
                    os.remove(old)
            with open(log, "w") as out:
                process = subprocess.Popen([*launcher, writer, path, str(n), str(changing)], stdout=out,
                                           stderr=subprocess.DEVNULL if launcher else None)
            kill(process, launcher, writer, log)
            process.wait()
            most = max(most, check(path, log, n, changing))
        assert most > 2, "the writer never got to write"

        # a limit on the size of files fails like a full disk, once its signal is ignored
        def small_disk():
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        ignoring = ["sh", "-c", 'trap "" XFSZ; exec "$@"', "sh"]  # launchers set signals back
        # libraries that start ranks need files of some megabytes too
        for limit, n in [(40_000_003, 20000)] if launcher else [(500_000, 700), (1_000_003, 700), (2_500_000, 700)]:
            with open(log, "w") as out:
                process = subprocess.run([*launcher, *ignoring, writer, path, str(n), "1"], stdout=out, stderr=subprocess.PIPE, text=True,
                                         preexec_fn=small_disk)
            assert process.returncode == 3, f"the writer ended with {process.returncode}: {process.stderr}"
            assert path in process.stderr and "full" in process.stderr, f"unclear message: {process.stderr}"
            assert check(path, log, n, 1) > 1
    print(f"{kills} kills and full disks: all committed frames read; at most {most} frames in a file")


if __name__ == "__main__":
    main()
