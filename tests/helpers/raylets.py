"""A Ray cluster of two nodes on this machine, in a process of its own.

The process prints its address. The line `kill` on its stdin kills the second node's raylet; the end of its stdin ends
the cluster.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager


@contextmanager
def two_nodes(environment: Mapping[str, str]) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A cluster that lasts as long as the context.

    Args:
      environment: the variables of its processes.

    Returns:
      The process and the cluster's address.
    """
    line, pipe = [sys.executable, "-m", "tests.helpers.raylets"], subprocess.PIPE
    with subprocess.Popen(line, env=dict(environment), stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin
        assert process.stdout
        address = next(line for line in process.stdout if re.fullmatch(r"[\d.]+:\d+\n", line))
        yield process, address.strip()
        process.stdin.close()
        process.wait(60)


def main() -> None:
    from ray.cluster_utils import Cluster

    room = {"num_cpus": 1, "object_store_memory": 100_000_000, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=room)
    second = cluster.add_node(num_cpus=1, object_store_memory=100_000_000)
    cluster.wait_for_nodes()
    print(cluster.address, flush=True)
    for line in sys.stdin:
        if line.strip() == "kill":
            cluster.remove_node(second, allow_graceful=False)
            print("killed", flush=True)
    cluster.shutdown()


if __name__ == "__main__":
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
    main()
