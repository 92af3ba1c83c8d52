"""The public names: `tokt` loads one from its module when it is first used."""

from tokt.features.common.errors import ToktError as ToktError
from tokt.features.extractors.named_extractors import extractor_named as extractor_named
from tokt.features.frames.grid import Grid as Grid
from tokt.features.frames.mission import open_mission as open_mission
from tokt.inference.assembly.run import run as run
from tokt.inference.config import RunConfig as RunConfig
from tokt.inference.frame import Frame as Frame
from tokt.inference.policy.policy import SinglePolicy as SinglePolicy
from tokt.inference.policy.policy import judge_image as judge_image
from tokt.inference.recording.log import read_log as read_log
from tokt.inference.sources.files import open_source as open_source
from tokt.inference.texture.detector import TextureDetector as TextureDetector
from tokt.inference.verdict import Verdict as Verdict
from tokt.labels.labels import Labels as Labels
from tokt.labels.taxonomy import Taxonomy as Taxonomy
from tokt.models.bundle.bundle import Bundle as Bundle
from tokt.models.registry.load import load_model as load_model
from tokt.models.store.store import Store as Store
from tokt.training.compare.compare_options import CompareOptions as CompareOptions
from tokt.training.compare.compare_options import Comparison as Comparison
from tokt.training.compare.compare_options import compare as compare
from tokt.training.datasets.dataset import DatasetVersion as DatasetVersion
from tokt.training.datasets.dataset_options import DatasetOptions as DatasetOptions
from tokt.training.datasets.dataset_options import build_dataset as build_dataset
from tokt.training.evaluation.evaluate_options import EvaluateOptions as EvaluateOptions
from tokt.training.evaluation.evaluate_options import evaluate as evaluate
from tokt.training.fitting.train_options import TrainedVersion as TrainedVersion
from tokt.training.fitting.train_options import TrainOptions as TrainOptions
from tokt.training.fitting.train_options import train as train
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission as simulate_mission

__version__: str
