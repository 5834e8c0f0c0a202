"""Kill a writer at random moments, and let it run into a full disk: every committed frame must still be readable.

python3 check_crash.py WRITER [kills]
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
            expected = {"Points": frame, "PointData/velocity": -frame, "PointData/pressure": 0.5 * frame}
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


def main():
    writer = os.path.abspath(sys.argv[1])
    kills = int(sys.argv[2]) if len(sys.argv) > 2 else 10
    most = 0
    with tempfile.TemporaryDirectory() as folder:
        path, log = os.path.join(folder, "run.vtkhdf"), os.path.join(folder, "log")
        for k in range(kills):
            n, changing = random.choice((3, 700, 20000)), k % 2
            for old in (path, path + ".part"):
                if os.path.exists(old):
                    os.remove(old)
            with open(log, "w") as out:
                process = subprocess.Popen([writer, path, str(n), str(changing)], stdout=out)
            time.sleep(0.02 + 0.3 * random.random())
            process.send_signal(signal.SIGKILL)
            process.wait()
            most = max(most, check(path, log, n, changing))
        assert most > 2, "the writer never got to write"

        # a limit on the size of files fails like a full disk, once its signal is ignored
        def small_disk():
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        for limit in (500_000, 1_000_003, 2_500_000):
            with open(log, "w") as out:
                process = subprocess.run([writer, path, "700", "1"], stdout=out, stderr=subprocess.PIPE, text=True,
                                         preexec_fn=small_disk)
            assert process.returncode == 3, f"the writer ended with {process.returncode}: {process.stderr}"
            assert path in process.stderr and "full" in process.stderr, f"unclear message: {process.stderr}"
            assert check(path, log, 700, 1) > 1
    print(f"{kills} kills and 3 full disks: all committed frames read; at most {most} frames in a file")


if __name__ == "__main__":
    main()
