# The tasks. This is the only list of them: everything else is derived from it.
gpuphys_add_task(advect_rk2 grid_lattice)
gpuphys_add_task(poisson_neumann global_solve)
gpuphys_add_task(ccd_ee collision_query)
