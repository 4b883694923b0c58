"""Endpoint: the networks by which drives without labels can be labelled."""

from fastapi import Request, Response
from pydantic import BaseModel, Field

from app.context import ContextDep
from app.http.parameters import answer_page
from app.http.prices import priced
from app.http.routing import ApiRouter
from interloc.labelling.networks import describe_networks

router = ApiRouter(tags=["Drives"])


class NetworkModel(BaseModel):
    """A network of the service."""

    name: str
    size_bytes: int | None
    height: int | None = Field(description="Of the image that it takes.")
    width: int | None
    problem: str | None = Field(description="Why it cannot be used.")


class NetworkList(BaseModel):
    """The networks of the service."""

    models: list[NetworkModel]


@router.get_and_head("/models", response_model=NetworkList)
@priced("cheap", bound="what the operator has put into the folder of networks")
def list_models(request: Request, context: ContextDep) -> Response:
    """List the networks of the service (INTERLOC_MODELS): a drive that is committed with one needs no labels."""
    folder = context.settings.models
    models = [
        NetworkModel(
            name=each.name,
            size_bytes=each.bytes,
            height=each.height,
            width=each.width,
            problem=each.problem and each.problem.replace(f"{folder}/", ""),
        )
        for each in (describe_networks(folder) if folder is not None else ())
    ]
    return answer_page(request, NetworkList(models=models))
