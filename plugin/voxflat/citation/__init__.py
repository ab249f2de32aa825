"""The methods text: a paragraph for a paper on how flat maps were made, with its references."""
