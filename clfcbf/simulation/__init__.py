"""Plants and sensors that implement the hardware protocols, and a judge of their runs."""
