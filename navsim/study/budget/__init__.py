"""What a study will take of a machine, told before anything of its size is made: time, memory, disk.

Counts (samples, fixes, runs, combinations, scans) come from the code that makes the arrays; what each of them costs was
measured (time on the machine of `make bench`, memory as the peak of the process, files as they lie on disk).
`tests/product/test_budget.py` holds the estimates against files and processes.

    estimate   what an estimate is, and in words     machine      what there is
    landing, companions, studies                     an estimate for each kind of study
"""
