"""A registry that fails at a step of a change: what is said is what it then shows."""

import sqlite3
from contextlib import closing, contextmanager

import pytest
from mlflow.exceptions import MlflowException

from tests.calls import refused, refuses, succeeds
from tests.inference.test_faults import hold_row
from tokt.models.registry.registry import Registry

ONE = "tiny-lbp/1"


@contextmanager
def refusing(workspace, table, change="INSERT"):
    """Let the database refuse a change of a table, as a disk does."""
    refusal = f"CREATE TRIGGER refusal BEFORE {change} ON {table} "
    refusal += "BEGIN SELECT RAISE(ABORT, 'disk I/O error'); END"
    for statement in (refusal, "DROP TRIGGER refusal"):
        with closing(sqlite3.connect(workspace / "mlflow.db")) as database:
            database.execute(statement)
        if statement is refusal:
            yield


@pytest.fixture
def registry(workspace):
    return Registry(workspace)


def test_an_alias_that_cannot_be_moved(workspace, registry):
    command = ("models", "alias", ONE, "champion", "--workspace", workspace)
    with refusing(workspace, "registered_model_aliases"):
        refused("disk I/O error; tiny-lbp@champion is no version", *command)
    assert registry.find(ONE).aliases == ("challenger",)
    succeeds(*command)
    first = registry.find(ONE)
    registry.register("tiny-lbp", f"models:/{ONE}", first.run_id, None, {})
    with refusing(workspace, "registered_model_aliases", "UPDATE"):
        words = f"disk I/O error; tiny-lbp@champion is {ONE}"
        refuses(words, registry.set_alias, "tiny-lbp/2", "champion")
    assert registry.find("tiny-lbp@champion").label == ONE


def test_an_alias_whose_answer_is_lost_was_moved(registry, monkeypatch):
    point = registry.client.set_registered_model_alias

    def lose_answer(*arguments):
        point(*arguments)
        raise MlflowException("the connection was closed")

    monkeypatch.setattr(registry.client, "set_registered_model_alias", lose_answer)
    assert "champion" in registry.set_alias(ONE, "champion").aliases
    hold_row(
        "`tokt models alias` or `promote` on a registry that fails",
        "moved and code 0, or the line names the version that the alias is at",
        "nothing",
    )


def test_a_promotion_is_recorded_as_it_ended(workspace, registry):
    command = ("models", "promote", ONE, "--workspace", workspace)
    with refusing(workspace, "registered_model_aliases"):
        refused("disk I/O error; tiny-lbp@champion is no version", *command)
    assert registry.find(ONE).promotions == []
    with refusing(workspace, "model_version_tags"):
        said = refused("disk I/O error", *command)
    assert f"tiny-lbp@champion is {ONE}: the model registry" in said
    assert registry.find("tiny-lbp@champion").label == ONE
    hold_row(
        "a promotion that cannot be recorded in the registry",
        "the line names the version that the alias is at by then, code 2",
        "nothing",
    )


@pytest.mark.parametrize("table", ["model_versions", "registered_model_aliases"])
def test_a_training_that_ends_as_it_is_registered(workspace, registry, table):
    options = ("--extractor", "lbp", "--preset", "plain", "--name", "more", "--folds", 3)
    with refusing(workspace, table):
        words = "is logged, and tokt models list shows whether it is registered: "
        refused(words, "train", "tiny", *options, "--embargo", 1, "--workspace", workspace)
    listed = [version.label for version in registry.versions("more")]
    assert listed == ([] if table == "model_versions" else ["more/1"])
    hold_row(
        "`tokt train` whose registry fails after the run was logged",
        "the line names the run and the command that shows whether it is registered, code 2",
        "nothing",
    )
