"""ROS 2 bags as tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from symo_exp.data.paths import few
from symo_exp.errors import ConfigError, shortened

JOINTS = "sensor_msgs/msg/JointState"


def bag_table(file: Path) -> pd.DataFrame:
    """Return the joint states of a ROS bag: position ``q_``, velocity ``v_``, effort ``u_``.

    Raises:
        ConfigError: If the bag cannot be read, or does not have one topic of joint states.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ConfigError(
            f"data.path={file}: reading a ROS bag needs rosbags, which is not installed: "
            "pip install 'symo_exp[ros]'"
        ) from error
    folder = file.parent if (file.parent / "metadata.yaml").is_file() and file.is_file() else file
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            topics = {c.topic: c.msgtype for c in reader.connections}
            joints = [c for c in reader.connections if c.msgtype == JOINTS]
            if len({c.topic for c in joints}) != 1:
                there = few(sorted(topics)) or "none"
                raise ConfigError(
                    f"data.path={file}: expected one topic of {JOINTS}; it has {there}; "
                    "save the signals as a table of columns t, q_<name>, u_<name>"
                )
            messages = [
                reader.deserialize(raw, c.msgtype)
                for c, _, raw in reader.messages(connections=joints)
            ]
    except ConfigError:
        raise
    except Exception as error:  # the library has many
        reason = shortened(error, 200)
        raise ConfigError(f"data.path={file}: cannot be read as a ROS bag ({reason})") from error
    return joint_states(file, messages)


def joint_states(file: Path, messages: Sequence[Any]) -> pd.DataFrame:
    """Return the messages of a topic of joint states, those that lack some of the joints left out.

    Args:
        file: The bag, for the error.
        messages: The messages, whose joints may be in any order.

    Raises:
        ConfigError: If there is no message, or none has all joints, as those of two publishers.
    """
    if not messages:
        raise ConfigError(f"data.path={file}: the bag has no joint states")
    counts = Counter(frozenset(message.name) for message in messages)
    every = frozenset().union(*counts)
    if every not in counts:
        told = "; ".join(f"{few(sorted(part))} ({count})" for part, count in counts.most_common(3))
        raise ConfigError(
            f"data.path={file}: no joint state has all joints, as from several publishers; its "
            f"messages have {told}; save the signals as a table of columns t, q_<name>, u_<name>"
        )
    whole = [message for message in messages if every == set(message.name)]
    joints = list(whole[0].name)
    orders = [[list(message.name).index(name) for name in joints] for message in whole]
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in whole])
    columns: dict[str, np.ndarray] = {"t": (stamps - stamps[0]) * 1e-9}
    for kind, field in (("q", "position"), ("v", "velocity"), ("u", "effort")):
        rows = [getattr(message, field) for message in whole]
        if all(len(row) == len(joints) for row in rows):
            values = np.array([np.asarray(x)[order] for x, order in zip(rows, orders, strict=True)])
            columns |= {f"{kind}_{name}": values[:, i] for i, name in enumerate(joints)}
    return pd.DataFrame(columns)
