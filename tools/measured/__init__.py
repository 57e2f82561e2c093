"""Evaluate the measured data of a cable drive (TSA_DATA, else ../shared/data)."""
