"""A process that writes runs into a store: python -m tests.history.store.writer URL PREFIX COUNT RESULTS."""

import sys

from crosscheck.history.runs import open_store, run_from_document, save
from tests.history.store.documents import document, many


def main(url, prefix, count, results):
    """Write `count` runs of `results` results each, and say after each that it is written."""
    store = open_store(url)
    content = document(many(results))
    print("ready", flush=True)
    for number in range(count):
        save(store, run_from_document(f"{prefix}-{number}", content))
        print(f"{prefix}-{number}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
