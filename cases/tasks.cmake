# The tasks. This is the only list of them: everything else is derived from it.
gpuphys_add_task(advect_rk2 grid_lattice)
gpuphys_add_task(lbm_d3q19 grid_lattice)
gpuphys_add_task(poisson_neumann global_solve)
gpuphys_add_task(p2g_mpm particle_grid)
gpuphys_add_task(contact_dem local_interaction)
gpuphys_add_task(solve_constraint_xpbd position_constraint)
gpuphys_add_task(ccd_ee collision_query)
