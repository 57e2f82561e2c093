"""The distribution: built, checked, tried bare; and the licences of what it needs."""
