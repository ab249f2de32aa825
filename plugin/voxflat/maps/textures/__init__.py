"""Pictures on surfaces and on maps."""
