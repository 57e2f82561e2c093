"""What measures, attacks, pictures and hosts the package: nothing that it imports."""
