"""Endpoint: the networks by which drives without labels can be labelled."""

from fastapi import APIRouter
from pydantic import BaseModel, Field

from app.context import ContextDep
from app.http.gate import ClientDep
from app.http.prices import priced
from app.networks import work as models

router = APIRouter(tags=["Drives"])


class NetworkModel(BaseModel):
    """A network that labels scans."""

    name: str = Field(description="Value of the option `model` of a drive.", examples=["salsanext"])
    size_bytes: int | None = Field(description="Size of the network.")
    height: int | None = Field(description="Rows of its range image.", examples=[64])
    width: int | None = Field(description="Columns of its range image.", examples=[2048])
    seconds_per_scan: float | None = Field(
        description="Time for a scan on one core of this service, measured the last time; null where it was not used "
        "yet. Only keyframes are labelled, about one scan per two metres.",
        examples=[0.35],
    )
    problem: str | None = Field(description="Why it cannot be used.")


class NetworkList(BaseModel):
    """The networks of the service."""

    models: list[NetworkModel]


@router.get("/models", summary="List networks that label scans")
@priced("cheap", bound="what the operator has put into the folder of networks")
def list_models(context: ContextDep, _client: ClientDep) -> NetworkList:
    """Return the networks of the service (INTERLOC_MODELS): a drive that is committed with one needs no labels."""
    cache, folder = context.storage.folder("cache"), context.settings.models
    return NetworkList(
        models=[
            NetworkModel(
                name=each.name,
                size_bytes=each.bytes,
                height=each.height,
                width=each.width,
                seconds_per_scan=models.seconds_per_scan(cache, each.name),
                problem=None if each.problem is None or folder is None else each.problem.replace(f"{folder}/", ""),
            )
            for each in models.available(folder)
        ]
    )
