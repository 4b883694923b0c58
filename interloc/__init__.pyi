from .city.citymap import CityMap as CityMap
from .city.citymap import merge as merge
from .city.folder import read_city as read_city
from .city.folder import write_city as write_city
from .config import DetectorConfig as DetectorConfig
from .config import preset as preset
from .detection.detector import Detector as Detector
from .detection.scan import Scan as Scan
from .drives.inspect import inspect_drive as inspect_drive
from .drives.open import open_drive as open_drive
from .errors import InterLocError as InterLocError
from .evaluation.evaluate import evaluate as evaluate
from .evaluation.report import geodataframe as geodataframe
from .evaluation.report import write_report as write_report
from .localization.locate import locate as locate
from .osm.reader import read_osm as read_osm
from .output.read import read_results as read_results
from .output.roads import roads as roads
from .output.write import write_results as write_results
from .pipeline import detect as detect
from .pipeline import stream as stream

__version__: str
