"""What copies of a workspace's labels hold while `tokt label` runs, and after it was killed."""

import shutil
import threading

from tests.calls import succeeds
from tests.inference.test_faults import hold_row
from tests.waiting import until
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.store.write_ahead_log import has_log


def test_labels_db_copied_alone_after_a_kill_has_the_labels(page_server, tmp_path):
    server = page_server()
    for cell in range(49):
        server.paint(f"cell-{cell}", 1, [cell], "ocean")
    until(lambda: not has_log(server.workspace / FILE_NAME))
    server.kill()
    copy = shutil.copy(server.workspace / FILE_NAME, tmp_path / FILE_NAME)
    with LabelStore(copy, create=False) as store:
        assert len(store.current("tiny", "anna")) == 49
    hold_row(
        "SIGKILL of `tokt label`, then labels.db is copied alone",
        "every label that is older than some seconds",
        "nothing",
    )


def test_a_backup_while_somebody_labels(page_server, tmp_path):
    server, done, ended = page_server(), [], threading.Event()

    def label():
        while not ended.is_set():
            frame, cell = divmod(len(done), 100)
            server.paint(f"cell-{len(done)}", 1 + frame, [cell], "ocean")
            done.append(cell)

    labelling = threading.Thread(target=label)
    labelling.start()
    try:
        for n in range(3):
            before = until(lambda n=n: len(done) > 30 * n and len(done))
            succeeds("labels", "backup", tmp_path / f"{n}.db", "--workspace", server.workspace)
            with LabelStore(tmp_path / f"{n}.db", create=False) as store:
                assert before <= len(store.current("tiny", "anna")) <= len(done) + 1
    finally:
        ended.set()
        labelling.join()
    hold_row(
        "`tokt labels backup` while somebody labels",
        "all that was saved when it began, in one checked file",
        "nothing",
    )
