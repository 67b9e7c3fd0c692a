"""``schema`` as users meet it; ``doctor`` has its tests beside its room."""

import json

import jsonschema
import yaml

from simulator.config import default_config_text


def test_schema_describes_the_shipped_configuration(flatlight) -> None:
    schema = json.loads(flatlight("schema")[1])
    validator = jsonschema.validators.validator_for(schema)
    validator.check_schema(schema)
    config = yaml.safe_load(default_config_text())
    validator(schema).validate(config)
    config["camera"]["sensr"] = {}
    assert not validator(schema).is_valid(config)
