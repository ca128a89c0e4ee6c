"""Each worker of a parallel run has a core of its own."""

import os

if "PYTEST_XDIST_WORKER" in os.environ:
    # Torch and BLAS would each start as many threads as there are cores in every worker, and these wait for each other:
    # training takes several times as long. It is read when they are first imported, and by the processes that tests start.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
