"""Endpoints: archive."""

from __future__ import annotations

from fastapi import APIRouter

router = APIRouter(tags=["archive"])
