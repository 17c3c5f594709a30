"""What a plain photograph shows: matte, landmarks and clothes, by embedded networks and colours.

Arrays in, arrays out; `io.networks` reads the weights.
"""
