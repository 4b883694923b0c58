"""The networks by which drives without labels can be labelled."""
