"""Models that engines use: Lambert, GGX with a diffuse term, glTF 2.0, Disney principled, OpenPBR."""
