"""The tests of mapp-twin, one package per part of the project."""
