from typing import Any

from tokt.models.bundle.card import model_card
from tokt.models.water import WaterPrior

DEEP = {"resize": "area_deep", "gray": "bt601", "gain": 8.0, "levels": 256}
DEEP |= {"flatten": {"window": 31, "by": "frame"}}
RECIPE: dict[str, Any] = {
    "extractor_name": "lbp",
    "extractor": {
        "name": "join",
        "parts": [
            {"name": "lbp", "points": 24, "radius": 8, "border": "frame", "image": DEEP},
            {"name": "context", "part": {"name": "haralick"}, "statistic": "mean"},
            {"name": "of tomorrow", "bins": 3},
        ],
    },
    "operating_point": {
        **{"margin": 0.5, "least_patches": 2, "hits": 2, "window": 3, "margin_now": None},
        "chosen": {
            **{"target_rate": 1e-4, "method": "By hand.", "words": "Seen: 3 of 99.", "tail": {}},
            "upper_bound": {"confidence": 0.95, "of_frames": 0.0761, "of_blocks": 0.5},
        },
    },
    "dim": 12,
    "grid": {"rows": 1, "cols": 1, "width": None},
    "thresholds": [0.25],
    "classes": [{"name": "ocean", "obstacle": False}, {"name": "tower", "obstacle": True}],
    "metrics": {
        "split": "five folds by blocks of 20 frames",
        "patch": {"f1": 0.87654, "precision": 1.0, "recall": 0.5, "average_precision": None}
        | {"macro_f1": 0.75},
        "folds": [
            {"f1": 0.75, "frames": "1-20"},
            {"f1": 0.25, "frames": ",".join(map(str, range(101, 200, 2)))},
            {"f1": None, "frames": "41-60"},
        ],
        "frames": {
            **{"false_status": 3, "ocean_frames": 99, "false_status_frames": ["d:7", "d:8", "d:9"]},
            **{"obstacle_frames": 40, "detected": 20, "first_detection": {"d": 141}},
            "missed_frames": [f"d:{number}" for number in range(100, 120)],
            "false_status_per_hour": {
                **{"rate_fps": None, "in_frames": 1000.0, "false_status": 30.303},
                "upper_bound": {
                    "confidence": 0.95,
                    "of_frames": 76.5,
                    "of_blocks": 9.0,
                    "blocks": 50,
                },
            },
            "approaches": [
                {"mission": "d", "camera": "left", "first_obstacle_frame": 139, "frames_late": 2},
                {
                    "mission": "d",
                    "camera": "left",
                    "first_obstacle_frame": 180,
                    "frames_late": None,
                },
            ],
        },
        "stress": {
            "gain_0.5": {
                **{"f1": 0.8, "fall": 0.076, "false_status": 4, "ocean_frames": 99},
                **{"detected": 15, "obstacle_frames": 40, "learnt": True},
            }
        },
    },
}


PROVENANCE = {"mlflow_run_id": "abc", "dataset": "dive@12", "missions": {"d": 99}}
PROVENANCE |= {"label_counts": {"ocean": 900, "tower": 100}}


def test_card_states_what_was_measured():
    card = model_card("tower/3", RECIPE, PROVENANCE)
    assert card.startswith("# tower/3\n")
    for line in (
        "- classes: ocean (clear), tower (obstacle)",
        "| obstacle patches: F1 | 0.877 |",
        "| average precision | undefined |",
        "| F1 of the folds | 0.750, 0.250, undefined |",
        "| open-ocean frames with a false status | 3 of 99 |",
        "| false statuses in 1,000 of them | 30.3, at most 76.5 with 95% confidence, were frames "
        "independent |",
        "| obstacle frames with status 1 | 20 of 40 |",
        "| first status of each approach | d 139: 2 frames late, d 180: never |",
        "| first of three frames in a row with status 1 | d 141 |",
        "- label counts: ocean 900; tower 100",
        "- upper bound: confidence 0.95; of_blocks 0.5; of_frames 0.0761",
        "Seen: 3 of 99.",
        "- false status on open ocean: d:7, d:8, d:9",
        "| gain 0.5 (learnt from) | 0.800 | 0.076 | 4 of 99 | 15 of 40 |",
    ):
        assert line in card.splitlines(), line
    for words in (
        "`lbp`, 12 features a patch: LBP (24,8) across patch edges on the picture",
        '+ {"bins": 3, "name": "of tomorrow"}',
        "2 patches over the threshold by more than 0.5, each in 2 of 3 frames",
        "a status comes 1 frame after a patch first exceeds the margin, at the earliest",
        "- lowest fold: F1 0.250 on frames 101,103",
    ):
        assert words in card, words
    assert len(card.splitlines()) < 100, "two pages"


def test_of_several_dives_each_is_named():
    dives = {"fjord": {"f1": 0.75}, "quay, by night": {"f1": None}}
    recipe = {**RECIPE, "metrics": {**RECIPE["metrics"], "dives": dives}}
    card = model_card("tower/3", recipe, PROVENANCE)
    assert "| F1 of the dives | fjord 0.750, quay, by night undefined |" in card
    assert "F1 of the folds" not in card


def test_a_boundary_that_moves_is_told_once():
    """In the prior's words of today; earlier models have such words among their figures too."""
    prior = WaterPrior(-1.0, 1.0, 0.5, 0.5, 0.25)
    was = RECIPE["operating_point"]
    told = {"boundary": "It moved.", "novelty": "A frame in which a patch is farther than 2.5 ..."}
    now = {**was, "water": prior.to_json(), "chosen": {**was["chosen"], **told}}
    lines = model_card("tower/3", {**RECIPE, "operating_point": now}, PROVENANCE).splitlines()
    assert lines.count(prior.words()) == lines.count(told["novelty"]) == 1
    assert not [line for line in lines if "It moved." in line or line.startswith("- novelty")]
    unchosen = {**now, "chosen": {}}
    assert prior.words() in model_card("tower/3", {**RECIPE, "operating_point": unchosen}, {})


def test_a_recipe_of_version_1_has_a_card_too():
    old = {key: value for key, value in RECIPE.items() if key != "operating_point"}
    frames = {"false_status": 3, "ocean_frames": 99, "false_status_frames": []}
    old["metrics"] = {**RECIPE["metrics"], "frames": frames}
    card = model_card("tower/3", old, {"dataset": "dive@12"})
    assert "Status 1 with 1 patch over the threshold, in one frame" in card
    assert "not chosen for a stated rate" in card
    assert "| open-ocean frames with a false status | 3 of 99 |" in card


def test_what_says_nothing_is_left_out_or_put_in_words():
    frames = {"false_status": 0, "ocean_frames": 0, "false_status_frames": []}
    frames |= {"obstacle_frames": 4, "detected": 3, "missed_frames": []}
    frames |= {"first_detection": {"a": 7, "b": None}, "approaches": []}
    chosen = {"target_rate": 1e-4, "method": "none", "words": "Nothing was chosen.", "tail": None}
    recipe = {**RECIPE, "metrics": {**RECIPE["metrics"], "frames": frames}}
    recipe["operating_point"] = {**RECIPE["operating_point"], "chosen": chosen}
    origin = {"class_weight": "none", "learnt_changes": "none", "preset": None, "search": ""}
    card = model_card("tower/3", recipe, {**origin, "missions": {"a": 4, "b": None}})
    lines = card.splitlines()
    assert "| first of three frames in a row with status 1 | a 7; b never |" in lines
    assert "| open-ocean frames with a false status | no such frame was labelled |" in lines
    assert "- an obstacle and no status 1: no frame" in lines
    assert "false status on open ocean:" not in card
    assert not [line for line in lines if line.rstrip(" |").endswith(("none", "None"))]
    for name in ("class weight", "learnt changes", "preset", "search"):
        assert f"- {name}" not in card
    none = {**frames, "obstacle_frames": 0, "detected": 0, "first_detection": {"a": None}}
    recipe["metrics"] = {**recipe["metrics"], "frames": none}
    card = model_card("tower/3", recipe, {})
    assert "first of three" not in card
    assert "| obstacle frames with status 1 | no such frame was labelled |" in card
