"""The layers of a result as GeoDataFrames, for notebooks and GIS in Python."""

from typing import Any

from interloc.errors import ConfigError
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.report import LAYER_FEATURES
from interloc.output.layers import LAYERS
from interloc.output.layout import ROAD_LAYERS
from interloc.output.properties import origin_of
from interloc.output.roads import road_features, roads
from interloc.output.write import TABLE_FEATURES
from interloc.results import DriveResult

_DTYPES = {"int": "Int64", "float": "float64", "bool": "boolean"}
"""Kind of a property -> column of pandas; those with a capital letter and `boolean` know null."""


def geodataframe(of: DriveResult | Evaluation, layer: str = "intersections") -> Any:  # noqa: ANN401 - no types
    """Return a layer of a result or an evaluation as a GeoDataFrame; its `explore` shows it on a map.

    Parameters
    ----------
    of
        An evaluation adds its verdicts, and the layers `osm_nodes` and `matches`.
    layer : str
        intersections, detections, keyframes, trajectory, roads, junctions or road_surface; of an evaluation osm_nodes,
        matches or osm_roads too.

    Returns
    -------
    geopandas.GeoDataFrame
        The columns are the properties of the GeoJSON files (`interloc.output.layers`) without their details; `attrs`
        has drive, job, preset and labels. Coordinates are longitude and latitude (EPSG:4326); without georeference
        they are metres in the frame of the first scan, and there is no coordinate system.

    Raises
    ------
    ConfigError
        There is no such layer.
    """
    from geopandas import GeoDataFrame  # noqa: PLC0415 - slow to import
    from shapely.geometry import shape  # noqa: PLC0415

    result = of.result if isinstance(of, Evaluation) else of
    if isinstance(of, Evaluation) and layer in LAYER_FEATURES:
        features = LAYER_FEATURES[layer](of, result)
    elif layer in TABLE_FEATURES:
        features = TABLE_FEATURES[layer](result)
    elif layer in ROAD_LAYERS:
        features = road_features(roads(result))[layer]
    elif layer in LAYER_FEATURES:
        raise ConfigError(
            f"{layer!r} is a layer of an evaluation: interloc.evaluate(result, graph).geodataframe({layer!r})"
        )
    else:
        raise ConfigError(
            f"{layer!r} is not a layer. Expected one of "
            f"{', '.join(dict.fromkeys((*TABLE_FEATURES, *ROAD_LAYERS, *LAYER_FEATURES)))}."
        )
    fields = LAYERS[layer].fields
    table = GeoDataFrame(
        {name: [feature["properties"][name] for feature in features] for name in fields},
        geometry=[feature["geometry"] and shape(feature["geometry"]) for feature in features],
        crs="EPSG:4326" if result.is_georeferenced else None,
    )
    table.attrs |= origin_of(result.run, result.drive)
    return table.astype({name: _DTYPES[kind] for name, kind in fields.items() if kind in _DTYPES})
