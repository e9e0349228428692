"""What a study will take of a machine, told before anything of its size is made: memory and disk.

Counts (samples, fixes, runs, combinations, scans) come from the code that makes the arrays; what each of them costs was
measured (memory as the peak of the process, files as they lie on disk). Each job makes its own (`study.job.Job`);
`tests/product/test_budget.py` holds them against files and processes. The time is told by a block that is timed.

    estimate   what an estimate is, and in words     machine      what there is
"""
