"""The documentation of the API as a page that needs nothing from other hosts.

With the page installed it is Swagger UI, from the npm package; without it, a plain listing of the same OpenAPI.
"""

from __future__ import annotations

from typing import Any

SWAGGER = "node_modules/swagger-ui-dist/swagger-ui-bundle.js"

SWAGGER_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>InterLoc API</title>
<link rel="icon" href="static/icon.svg" type="image/svg+xml">
<link rel="stylesheet" href="static/node_modules/swagger-ui-dist/swagger-ui.css">
</head>
<body>
<div id="swagger-ui"></div>
<script src="static/node_modules/swagger-ui-dist/swagger-ui-bundle.js"></script>
<script src="docs/start.js"></script>
</body>
</html>
"""

SWAGGER_START = """SwaggerUIBundle({
  url: new URL("openapi.json", document.baseURI).href,
  dom_id: "#swagger-ui",
  deepLinking: true,
  displayRequestDuration: true,
  validatorUrl: null,
  presets: [SwaggerUIBundle.presets.apis, SwaggerUIBundle.SwaggerUIStandalonePreset],
});
"""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Swagger UI writes style attributes; scripts come from this service only."""

_LISTING = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{{ info.title }} API</title>
<style>
body { font: 16px/1.55 system-ui, sans-serif; max-width: 60rem; margin: 0 auto; padding: 1.5rem 1rem 4rem; }
h2 { margin: 2.5rem 0 .5rem; }
summary { cursor: pointer; padding: .3rem 0; }
code, pre { font: .9em/1.45 ui-monospace, monospace; overflow-wrap: anywhere; }
.verb { display: inline-block; min-width: 4.5rem; font-weight: 700; }
.body { padding: 0 0 1rem 4.5rem; white-space: pre-line; }
table { border-collapse: collapse; white-space: normal; } td { padding: .1rem 1rem .1rem 0; vertical-align: top; }
</style>
</head>
<body>
<h1>{{ info.title }} API {{ info.version }}</h1>
<p>{{ info.summary }}</p>
<p>For programs: <a href="openapi.json">openapi.json</a>. The page of the service is not installed
(<code>npm ci --omit=dev</code> in its folder <code>static</code>); the API works without it.</p>
{% for tag, operations in groups %}
<h2>{{ tag }}</h2>
{% for verb, path, operation in operations %}
<details><summary><code><span class="verb">{{ verb }}</span>{{ path }}</code> &nbsp; {{ operation.summary }}</summary>
<div class="body">{{ operation.description or "" }}
{% if operation.parameters %}<table>
{% for p in operation.parameters %}
<tr><td><code>{{ p.name }}</code></td><td>{{ p.in }}{{ ", required" if p.required }}</td>
<td>{{ p.description or "" }}</td></tr>
{% endfor %}</table>{% endif %}
<table>
{% for status, answer in operation.responses.items() %}
<tr><td><code>{{ status }}</code></td><td>{{ answer.description }}</td></tr>
{% endfor %}
</table></div></details>
{% endfor %}
{% endfor %}
</body>
</html>
"""


def listing(openapi: dict[str, Any]) -> str:
    """Return an OpenAPI document as a page without scripts."""
    from jinja2 import Environment  # noqa: PLC0415 - slow to import

    groups: dict[str, list[tuple[str, str, dict[str, Any]]]] = {}
    for path, operations in openapi["paths"].items():
        for verb, operation in operations.items():
            groups.setdefault((operation.get("tags") or ["Other"])[0], []).append((verb.upper(), path, operation))
    page = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(_LISTING)
    return page.render(info=openapi["info"], groups=groups.items())
