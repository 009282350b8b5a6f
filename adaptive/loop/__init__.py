"""A process under control: margins, Ms, simulation and performance."""
