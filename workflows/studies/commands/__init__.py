"""The command line of the studies, one file each; the file's name is the command's, bench_NAME that of a benchmark.

A file has a function ``command`` with the study's options and imports nothing heavy before it is called: the command
line finds it, and help and start-up stay quick.
"""
