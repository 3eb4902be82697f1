"""Recordings of the real robot: files or data in memory in, tiles of filtered states out."""

from torchrbd.recordings.chunk import Chunk
from torchrbd.recordings.clock import uniform_blocks
from torchrbd.recordings.drives import Drives, Gain
from torchrbd.recordings.filtering import Filtering
from torchrbd.recordings.formats.table import Format, Table
from torchrbd.recordings.inspection import Inspection, inspect_recording
from torchrbd.recordings.low_pass import LowPass
from torchrbd.recordings.mapping import Mapping
from torchrbd.recordings.mapping_file import read_mapping
from torchrbd.recordings.memory import Data, InMemory
from torchrbd.recordings.recording import Recording, open_recording
from torchrbd.recordings.sources import NamedSource, RecordingSource, Sources, listed_sources
from torchrbd.recordings.states import TILE_ROWS, States, skipped_segments, tiles
from torchrbd.recordings.survey import Survey, choose_cutoff, survey

__all__ = [
    "TILE_ROWS",
    "Chunk",
    "Data",
    "Drives",
    "Filtering",
    "Format",
    "Gain",
    "InMemory",
    "Inspection",
    "LowPass",
    "Mapping",
    "NamedSource",
    "Recording",
    "RecordingSource",
    "Sources",
    "States",
    "Survey",
    "Table",
    "choose_cutoff",
    "inspect_recording",
    "listed_sources",
    "open_recording",
    "read_mapping",
    "skipped_segments",
    "survey",
    "tiles",
    "uniform_blocks",
]
