"""The methods: `flatten` makes a map by any of them."""
