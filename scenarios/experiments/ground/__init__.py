"""The experiments of section 3.2, `sandpit` and `field`: what both of them share."""
