"""An MCAP file as its topics, read by the package `mcap` and held against its own schemas."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema
from mcap.reader import make_reader


@dataclass(frozen=True)
class Read:
    """Topics of a file: schemas by topic, messages as (time in ns, content), records by name."""

    schemas: dict[str, dict[str, Any]]
    messages: dict[str, list[tuple[int, dict[str, Any]]]]
    notes: dict[str, dict[str, str]]

    def column(self, topic: str, field: str) -> dict[int, float]:
        """Values of a field by time in ns."""
        return {t: m[field] for t, m in self.messages[topic] if field in m}


def read_mcap(path: Path) -> Read:
    """All messages, in the order of the file, each valid by its schema."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = Read({}, {}, {n.name: dict(n.metadata) for n in reader.iter_metadata()})
        checks: dict[str, jsonschema.Draft202012Validator] = {}
        last = -1
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None and schema.encoding == "jsonschema"
            assert channel.message_encoding == "json" and message.log_time >= last
            last = message.log_time
            if channel.topic not in checks:
                content = json.loads(schema.data)
                assert content["title"] == schema.name
                jsonschema.Draft202012Validator.check_schema(content)
                found.schemas[channel.topic] = content
                checks[channel.topic] = jsonschema.Draft202012Validator(content)
            told = json.loads(message.data)
            checks[channel.topic].validate(told)
            found.messages.setdefault(channel.topic, []).append((message.log_time, told))
    return found
