"""The judge: flat maps of any tool, matched to their surface and measured by the same definitions."""
