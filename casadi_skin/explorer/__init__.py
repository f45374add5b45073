"""A page that shows a run in a browser: one file with its data and plotly.js (4.1.1, MIT), without any network."""
