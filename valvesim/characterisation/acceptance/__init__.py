"""Static acceptance tests of a servo valve (SAE ARP490, ISO 10770-1): simulated and measured records alike."""
