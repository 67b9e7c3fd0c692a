"""``schema`` as users meet it; ``doctor`` has its tests beside its room."""

import json
import re

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


def test_schema_is_json_and_knows_every_key_of_the_shipped_configuration(flatlight) -> None:
    code, out, _ = flatlight("schema")
    assert code == 0
    schema = json.loads(out)
    for section, values in yaml.safe_load(default_config_text()).items():
        described = json.dumps(schema["properties"][section])
        models = [schema["$defs"][name] for name in re.findall(r"#/\$defs/(\w+)", described)]
        known = {key for model in models for key in model["properties"]}
        for key in values if isinstance(values, dict) else ():
            open_ended = section == "scene" and any(model.get("additionalProperties", True) for model in models)
            assert key in known or open_ended, f"{section}.{key}"
