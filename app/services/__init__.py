"""Use cases that cross storage, core and live sessions; one transaction each."""
