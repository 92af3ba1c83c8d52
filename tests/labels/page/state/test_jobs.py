"""What is kept of what a job's commands print."""

from tokt.labels.page.state.jobs import Job


def test_the_result_is_the_last_lines_of_the_step_before_the_export():
    job = Job("model", 3)
    for command, lines in {
        "dataset": ["built"],
        "train": ["begins", "features: 1/2", *"abcd", "", "e"],
        "export": ["written to tiny.tokt"],
    }.items():
        for line in lines:
            job.hear(line)
        job.end_step(command)
    assert job.result == [*"abcde"]
    assert job.lines[-1] == "written to tiny.tokt"
