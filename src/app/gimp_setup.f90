!> From a checked scene to a run that can start: grid, sides, materials, method, time, loads and the exact solution
module gimp_setup
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t, add_error
  use gimp_grid, only: make_grid
  use gimp_basis, only: basis_of_word, basis_linear, basis_cpgimp, basis_ugimp, basis_ddmp, is_sampled, spline_degree
  use gimp_point_domains, only: corner_rule, volume_rule, surface_rule, simpson_rule
  use gimp_domains, only: domain_of_word, domain_edges, domain_fixed, domain_carried
  use gimp_corner_domains, only: carried_none, carried_box, carried_simplex, corners_of
  use gimp_material_options, only: material_options_t
  use gimp_material_table, only: make_material
  use gimp_verification, only: verification_t, verification_options_t, make_verification, has_body_force
  use gimp_engine, only: least_spacing, law_t, affine_none, affine_apic, affine_tpic, affine_mls, anti_none, &
    anti_f_bar, anti_b_bar, anti_cell_stress
  use gimp_walls, only: set_walls
  use gimp_border, only: repartition_balanced, repartition_always, repartition_never
  use gimp_loads, only: has_loads
  use gimp_generalized_alpha, only: bifurcation_limit
  use gimp_newmark, only: newmark_limit
  use gimp_run_state, only: stepper_t, hands_on, scheme_of_word, usl, musl, series_none, series_xpic, series_fmpm, position_grid, &
    position_published, position_new, integrator_of_word, symplectic, newmark, damping_none, damping_local, damping_kinetic
  use gimp_step_size, only: rule_adaptive, rule_uniform, rule_fixed
  use gimp_stability, only: check_of_word
  use gimp_solution_force, only: solution_force_t
  use gimp_setup_sides, only: set_up_walls, set_up_loads, is_on_particles
  use gimp_setup_mesh, only: set_up_mesh
  use gimp_mesh_pads, only: prepare_mesh
  use gimp_scene, only: scene_t, count_groups, is_given, real_of, reals_of, integer_of, logical_of, word_of, text_of_key, complain
  use omp_lib, only: omp_get_max_threads, omp_set_num_threads
  implicit none(type, external)
  private
  public :: set_up_scene, body_named, set_up_threads

contains

  !> Everything but the particles; all mistakes are collected
  subroutine set_up_scene(scene, s, solution, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(verification_t), intent(out) :: solution
    type(error_t), allocatable, intent(out) :: error
    if (count_groups(scene, "mesh") > 0) then
      call set_up_mesh(scene, s, error)
      if (allocated(error)) return
    else
      s%engine%grid = make_grid(scene%dimension, reals_of(scene, "grid", 1, "lower"), reals_of(scene, "grid", 1, "upper"), &
                                real_of(scene, "grid", 1, "spacing"))
      call set_up_walls(scene, s%walls)
      call set_walls(s%walls, s%engine%grid)
    end if
    call set_up_materials(scene, s%engine%laws, error)
    if (allocated(error)) return
    call set_up_method(scene, s, error)
    if (s%engine%grid%is_mesh .and. .not. allocated(error)) call prepare_mesh(s%engine)
    call set_up_loads(scene, s%engine, s%loads, error)
    call set_up_solution(scene, s, solution, error)
    if (allocated(error)) return
    call set_up_time(scene, s)
    call set_up_ranks(scene, s)
  end subroutine set_up_scene

  !> How ranks share the work
  subroutine set_up_ranks(scene, s)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    select case (word_of(scene, "parallel", 1, "repartition"))
    case ("always"); s%engine%border%repartition = repartition_always
    case ("never"); s%engine%border%repartition = repartition_never
    case default; s%engine%border%repartition = repartition_balanced
    end select
    s%engine%border%most_imbalance = real(real_of(scene, "parallel", 1, "imbalance_limit"))
    ! forces at points and plain weight lists want all nodes around a block, not only those of its pad
    s%engine%border%always_whole = has_loads(s%loads) .or. s%engine%list_kernel
  end subroutine set_up_ranks

  !> Threads of this run: the scene's word, else the environment's, else one
  subroutine set_up_threads(scene, threads)
    type(scene_t), intent(in) :: scene
    integer, intent(out) :: threads
    character(len=32) :: value
    threads = integer_of(scene, "parallel", 1, "threads")
    if (threads == 0) then
      call get_environment_variable("OMP_NUM_THREADS", value)
      threads = 1
      if (value /= "") threads = omp_get_max_threads()
    end if
    call omp_set_num_threads(threads)
  end subroutine set_up_threads

  subroutine set_up_materials(scene, laws, error)
    type(scene_t), intent(in) :: scene
    type(law_t), allocatable, intent(out) :: laws(:)
    type(error_t), allocatable, intent(inout) :: error
    type(material_options_t) :: options
    type(error_t), allocatable :: problem
    integer :: m
    allocate (laws(count_groups(scene, "material")))
    do m = 1, size(laws)
      options = material_options_t()
      options%name = text_of_key(scene, "material", m, "name")
      options%model = word_of(scene, "material", m, "model")
      call take("density", options%density)
      call take("young_modulus", options%young_modulus)
      call take("poisson_ratio", options%poisson_ratio)
      call take("yield_stress", options%yield_stress)
      call take("hardening_modulus", options%hardening_modulus)
      call take("hardening_exponent", options%hardening_exponent)
      call take("hardening_strain", options%hardening_strain)
      call take("cohesion", options%cohesion)
      call take("friction_angle", options%friction_angle)
      call take("dilation_angle", options%dilation_angle)
      call take_word("hardening", options%hardening)
      call take_word("cone", options%cone)
      call take_word("rate", options%rate)
      call take_word("rate_form", options%rate_form)
      options%gradient_of_middle = word_of(scene, "method", 1, "deformation_update") /= "forward"
      call make_material(options, laws(m)%law, problem)
      if (allocated(problem)) call add_error(error, problem%message)
    end do

  contains

    subroutine take(key, value)
      character(len=*), intent(in) :: key
      real(dp), intent(inout) :: value
      if (is_given(scene, "material", m, key)) value = real_of(scene, "material", m, key)
    end subroutine take

    subroutine take_word(key, value)
      character(len=*), intent(in) :: key
      character(len=*), intent(inout) :: value
      if (is_given(scene, "material", m, key)) value = word_of(scene, "material", m, key)
    end subroutine take_word

  end subroutine set_up_materials

  subroutine set_up_method(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(inout) :: error
    s%engine%basis = basis_of_word(word_of(scene, "method", 1, "basis"))
    s%engine%domain_rule = 0
    if (s%engine%basis == basis_cpgimp) s%engine%domain_rule = domain_of_word(word_of(scene, "method", 1, "domain"))
    if (is_sampled(s%engine%basis)) call set_up_points(scene, s)
    s%engine%total = word_of(scene, "method", 1, "formulation") == "total"
    if (s%engine%total) call set_up_total(scene, s, error)
    if (s%engine%rule%carried /= carried_none) call check_carried(scene, s, error)
    if (spline_degree(s%engine%basis) > 0) call set_up_spline(scene, s, error)
    s%engine%dual_alpha = real(real_of(scene, "method", 1, "ddmp_alpha"), wp)
    s%engine%overlap = real(real_of(scene, "method", 1, "domain_overlap"), wp)
    s%engine%list_kernel = word_of(scene, "method", 1, "kernel") == "list"
    select case (word_of(scene, "method", 1, "deformation_update"))
    case ("forward"); s%engine%f_update = 2
    case ("exponential"); s%engine%f_update = 3
    case default; s%engine%f_update = 1
    end select
    s%method%scheme = scheme_of_word(word_of(scene, "method", 1, "stress_update"))
    s%method%flip = real(real_of(scene, "method", 1, "flip_fraction"), wp)
    if (word_of(scene, "method", 1, "transfer") == "pic") s%method%flip = 0.0_wp
    select case (word_of(scene, "method", 1, "transfer"))
    case ("apic"); s%engine%affine = affine_apic
    case ("tpic"); s%engine%affine = affine_tpic
    case ("mls"); s%engine%affine = affine_mls
    case default; s%engine%affine = affine_none
    end select
    if (s%engine%affine /= affine_none .and. s%engine%basis == basis_linear) call complain(error, scene, "method", 1, &
      "transfer", "diverges with basis = 'linear' (the carried gradient grows without bound at light nodes); use flip")
    if (s%engine%affine /= affine_none .and. s%engine%basis == basis_ddmp) call complain(error, scene, "method", 1, &
      "transfer", "cannot be had with basis = 'ddmp', whose values go by tents; use flip")
    call set_up_series(scene, s, error)
    if (s%engine%affine == affine_mls) call check_least_squares(scene, s, error)
    call set_up_anti_locking(scene, s, error)
    s%method%cutoff = real(real_of(scene, "method", 1, "mass_cutoff"), wp)
    s%method%redistribute = real(real_of(scene, "method", 1, "redistribute_mass"), wp)
    if (hands_on(s%method) .and. word_of(scene, "time", 1, "stability_check") /= "none") call complain(error, scene, &
      "time", 1, "stability_check", "does not know the forces that light nodes hand on (redistribute_mass in &method)")
    if (hands_on(s%method) .and. word_of(scene, "method", 1, "integrator") /= "symplectic") call complain(error, scene, "method", 1, &
      "redistribute_mass", "is for integrator = 'symplectic': the others give mass and force in one pass")
    s%method%half_start = logical_of(scene, "method", 1, "half_step_start")
    call set_up_integrator(scene, s, error)
    select case (word_of(scene, "method", 1, "damping"))
    case ("local"); s%method%damping = damping_local
    case ("kinetic"); s%method%damping = damping_kinetic
    case default; s%method%damping = damping_none
    end select
    s%method%damping_factor = real(real_of(scene, "method", 1, "damping_factor"), wp)
    s%method%filter_every = integer_of(scene, "method", 1, "null_space_filter")
    s%method%sort_every = integer_of(scene, "method", 1, "sort_every")
    if (s%engine%basis == basis_ugimp .and. is_given(scene, "method", 1, "domain")) &
      call complain(error, scene, "method", 1, "domain", "is read with basis = 'cpgimp' only")
  end subroutine set_up_method

  !> Averages over cells against locking
  subroutine set_up_anti_locking(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: word
    word = word_of(scene, "method", 1, "anti_locking")
    select case (word)
    case ("f_bar"); s%engine%anti_locking = anti_f_bar
    case ("b_bar"); s%engine%anti_locking = anti_b_bar
    case ("cell_stress"); s%engine%anti_locking = anti_cell_stress
    case default; s%engine%anti_locking = anti_none
    end select
    if (s%engine%anti_locking == anti_none) return
    if (word_of(scene, "time", 1, "stability_check") /= "none") call complain(error, scene, "time", 1, "stability_check", &
      "does not know the forces of anti_locking = '"//word//"'")
    if (word == "b_bar" .and. word_of(scene, "method", 1, "basis") == "cpdi2") call complain(error, scene, "method", 1, "anti_locking", &
      "has no adjoint force with basis = 'cpdi2', which takes the volume of its domains; use f_bar")
  end subroutine set_up_anti_locking

  !> The series of XPIC and FMPM
  subroutine set_up_series(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(inout) :: error
    s%method%series = series_none
    select case (word_of(scene, "method", 1, "transfer"))
    case ("xpic"); s%method%series = series_xpic
    case ("fmpm"); s%method%series = series_fmpm
    case default; return
    end select
    s%method%flip = 1.0_wp ! in the steps between
    s%method%order = integer_of(scene, "method", 1, "transfer_order")
    s%method%series_every = integer_of(scene, "method", 1, "transfer_every")
    select case (word_of(scene, "method", 1, "position_update"))
    case ("published"); s%method%position = position_published
    case ("new"); s%method%position = position_new
    case default; s%method%position = position_grid
    end select
    if (s%method%position == position_new .and. s%method%series == series_xpic) call complain(error, scene, "method", 1, &
      "position_update", "is for transfer = 'fmpm', whose particle velocities are grid velocities; use 'grid' or 'published'")
    if (s%method%series == series_xpic) return
    s%method%strain_by_series = word_of(scene, "method", 1, "strain_velocity") == "order_k"
    if (s%method%strain_by_series .and. s%method%scheme /= usl .and. s%method%scheme /= musl) call complain(error, scene, "method", &
      1, "strain_velocity", "is for stress_update = 'usl' or 'musl', which strain once a step with the new velocity; use 'lumped'")
  end subroutine set_up_series

  !> What steps in time, and what it asks of other keys
  subroutine set_up_integrator(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: by
    s%method%integrator = integrator_of_word(word_of(scene, "method", 1, "integrator"))
    s%method%spectral_radius = real(real_of(scene, "method", 1, "spectral_radius"), wp)
    if (s%method%integrator == symplectic) return
    s%method%newmark_gamma = real(real_of(scene, "method", 1, "newmark_gamma"), wp)
    s%time_options%reach = 0.45_dp*bifurcation_limit(s%method%spectral_radius) ! 0.9 of it; that of leap-frog is 2
    if (s%method%integrator == newmark) s%time_options%reach = 0.5_dp*newmark_limit(s%method%newmark_gamma)
    by = " with integrator = '"//word_of(scene, "method", 1, "integrator")//"'"
    if (word_of(scene, "method", 1, "transfer") /= "flip") then
      call complain(error, scene, "method", 1, "transfer", "must be 'flip'"//by)
    else if (s%method%flip < 1.0_wp) then
      call complain(error, scene, "method", 1, "flip_fraction", "must be 1"//by//", which adds changes to a velocity")
    end if
    if (s%method%scheme /= usl) call complain(error, scene, "method", 1, "stress_update", "must be 'usl'"//by)
    if (s%method%integrator == newmark .and. integer_of(scene, "method", 1, "null_space_filter") > 0) call complain(error, scene, &
      "method", 1, "null_space_filter", "cannot be had"//by//", whose velocities are whole only after the pass that would filter them")
    if (s%method%half_start) call complain(error, scene, "method", 1, "half_step_start", "must be .false."//by// &
                                           ", whose velocities are those of the end of a step")
  end subroutine set_up_integrator

  !> Moving least squares take w D^-1 (x_i - x_p) for the gradient of a weight: it is one where D is the same for every particle
  subroutine check_least_squares(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    type(error_t), allocatable, intent(inout) :: error
    if (spline_degree(s%engine%basis) == 0) then
      call complain(error, scene, "method", 1, "transfer", "does not converge with this basis; it is for the equal splines of "// &
                    "basis = 'bspline2' or 'bspline3' with spline_boundary = 'ghost'")
    else if (s%engine%grid%open_degree > 0) then
      call complain(error, scene, "method", 1, "transfer", "diverges at the ends of open knots; set spline_boundary = 'ghost'")
    end if
    if (word_of(scene, "time", 1, "stability_check") /= "none") call complain(error, scene, "time", 1, "stability_check", &
      "does not know the forces of transfer = 'mls'")
  end subroutine check_least_squares

  !> Total Lagrangian: domains stay as they start, and what follows present places is refused
  subroutine set_up_total(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(inout) :: error
    integer :: b
    s%engine%domain_rule = domain_fixed
    if (word_of(scene, "method", 1, "deformation_update") /= "forward") call complain(error, scene, "method", 1, &
      "deformation_update", "must be forward with formulation = 'total', whose gradients refer to the start: it is exact there")
    if (word_of(scene, "time", 1, "stability_check") /= "none") call complain(error, scene, "time", 1, "stability_check", &
      "does not know the forces of formulation = 'total'")
    do b = 1, count_groups(scene, "boundary")
      if (word_of(scene, "boundary", b, "condition") == "free" .and. word_of(scene, "boundary", b, "leaving") == "remove") &
        call complain(error, scene, "boundary", b, "leaving", "has no meaning with formulation = 'total': particles never leave "// &
                      "the places of the start")
    end do
    do b = 1, count_groups(scene, "body")
      if (is_given(scene, "body", b, "deformation_gradient")) call complain(error, scene, "body", b, "deformation_gradient", &
        "cannot be had with formulation = 'total': bodies must start undeformed")
    end do
  end subroutine set_up_total

  !> Points at which a basis samples its domains, and how large these may grow
  subroutine set_up_points(scene, s)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    integer :: d, n
    d = scene%dimension
    s%engine%domain_rule = domain_edges
    s%engine%longest_diagonal = real(real_of(scene, "method", 1, "domain_limit"), wp)
    select case (word_of(scene, "method", 1, "basis"))
    case ("cpdi")
      s%engine%rule = corner_rule(d)
      return
    case ("cpdi2")
      s%engine%domain_rule = domain_carried
      s%engine%rule%carried = carried_box
      if (word_of(scene, "method", 1, "particle_domain") == "simplex") s%engine%rule%carried = carried_simplex
      s%engine%rule%n = corners_of(s%engine%rule%carried, d)
      s%engine%domain_volume = word_of(scene, "method", 1, "cpdi2_volume") == "domain"
      s%engine%total_deformation = word_of(scene, "method", 1, "cpdi2_deformation") == "total"
      return
    end select
    select case (word_of(scene, "method", 1, "quadrature"))
    case ("simpson")
      s%engine%rule = simpson_rule(d)
    case ("surface")
      n = integer_of(scene, "method", 1, "quadrature_points")
      s%engine%rule = surface_rule(d, n)
    case default
      n = integer_of(scene, "method", 1, "quadrature_points")
      s%engine%rule = volume_rule(d, n)
    end select
  end subroutine set_up_points

  !> What domains whose corners move with the grid cannot do
  subroutine check_carried(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    type(error_t), allocatable, intent(inout) :: error
    integer :: k
    if (s%engine%total) call complain(error, scene, "method", 1, "formulation", "'total' leaves domains where they start, so that corners "// &
      "have nowhere to go; use basis = 'cpdi'")
    if (s%engine%total_deformation .and. is_given(scene, "method", 1, "deformation_update")) call complain(error, scene, "method", 1, &
      "deformation_update", "is not read with cpdi2_deformation = 'total', where F follows from the corners; take it away")
    if (s%engine%total_deformation .and. (word_of(scene, "method", 1, "stress_update") /= "usl" .or. &
                                          word_of(scene, "method", 1, "strain_velocity") == "order_k")) call complain(error, scene, "method", 1, &
      "cpdi2_deformation", "'total' needs stress_update = 'usl' and strains from the velocity that moves the corners; use 'incremental'")
    if (s%engine%total_deformation .and. word_of(scene, "method", 1, "anti_locking") /= "none") call complain(error, scene, "method", 1, &
      "cpdi2_deformation", "'total' cannot be had with anti_locking, whose averages are of increments; use 'incremental'")
    if (is_given(scene, "method", 1, "position_update") .and. word_of(scene, "method", 1, "position_update") /= "grid") &
      call complain(error, scene, "method", 1, "position_update", "moves particles with their own velocity, which corners do not have; use 'grid'")
    if (s%engine%rule%carried /= carried_simplex) return
    do k = 1, count_groups(scene, "load")
      if (is_on_particles(scene, k) .and. word_of(scene, "load", k, "kind") /= "point_force") &
        call complain(error, scene, "load", k, "kind", "acts on faces of the fill lattice, which simplices do not have; set particle_domain = 'box'")
    end do
  end subroutine check_carried

  !> Where the knots of a spline end; open knots have no nodes beyond a side that images could stand for
  subroutine set_up_spline(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: condition
    integer :: b
    if (word_of(scene, "method", 1, "spline_boundary") == "ghost") return
    s%engine%grid%open_degree = spline_degree(s%engine%basis)
    do b = 1, count_groups(scene, "boundary")
      condition = word_of(scene, "boundary", b, "condition")
      if (condition == "symmetry" .or. condition == "periodic") call complain(error, scene, "boundary", b, "condition", &
        "cannot be had with open-knot splines; set spline_boundary = 'ghost' in &method")
    end do
  end subroutine set_up_spline

  !> Number of the body of that name, 0 if there is none
  pure integer function body_named(scene, name) result(body)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: name
    integer :: b
    body = 0
    do b = 1, count_groups(scene, "body")
      if (text_of_key(scene, "body", b, "name") == name) body = b
    end do
  end function body_named

  !> The exact solution, with the constants of the (one) material it is for
  subroutine set_up_solution(scene, s, solution, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(verification_t), intent(inout) :: solution
    type(error_t), allocatable, intent(inout) :: error
    type(verification_options_t) :: options
    type(error_t), allocatable :: problem
    type(solution_force_t), allocatable :: force
    real(dp) :: density, young, poisson
    integer :: d
    if (count_groups(scene, "verification") == 0) return
    d = scene%dimension
    options%solution = word_of(scene, "verification", 1, "solution")
    call take("amplitude", options%amplitude)
    call take("speed", options%speed)
    call take("length", options%length)
    call take("period", options%period)
    call take("gravity", options%gravity)
    call take("inner_radius", options%inner_radius)
    call take("outer_radius", options%outer_radius)
    call take_vector("velocity", options%velocity)
    call take_vector("center", options%center)
    call take_vector("phases", options%phases)
    if (is_given(scene, "verification", 1, "angular_velocity")) then
      if (d == 2) then
        options%angular_velocity = 0.0_dp
        options%angular_velocity(3:3) = reals_of(scene, "verification", 1, "angular_velocity")
      else
        call take_vector("angular_velocity", options%angular_velocity)
      end if
    end if
    if (size(s%engine%laws) > 1) then
      call complain(error, scene, "verification", 1, "solution", "an exact solution is for scenes with one material")
      return
    end if
    associate (law => s%engine%laws(1)%law)
      density = law%density
      if (is_given(scene, "material", 1, "density")) density = real_of(scene, "material", 1, "density")
      young = law%mu*(3.0_wp*law%lambda + 2.0_wp*law%mu)/(law%lambda + law%mu)
      poisson = 0.5_wp*law%lambda/(law%lambda + law%mu)
      if (is_given(scene, "material", 1, "young_modulus")) young = real_of(scene, "material", 1, "young_modulus")
      if (is_given(scene, "material", 1, "poisson_ratio")) poisson = real_of(scene, "material", 1, "poisson_ratio")
      call make_verification(options, d, trim(law%model), density, young, poisson, solution, problem)
    end associate
    if (allocated(problem)) then
      call add_error(error, problem%message)
      return
    end if
    if (has_body_force(solution)) then
      allocate (force)
      force%solution = solution
      force%grid = s%engine%grid
      call move_alloc(force, s%engine%body_force)
    end if

  contains

    subroutine take(key, value)
      character(len=*), intent(in) :: key
      real(dp), intent(inout) :: value
      if (is_given(scene, "verification", 1, key)) value = real_of(scene, "verification", 1, key)
    end subroutine take

    subroutine take_vector(key, value)
      character(len=*), intent(in) :: key
      real(dp), intent(inout) :: value(3)
      real(dp), allocatable :: given(:)
      if (.not. is_given(scene, "verification", 1, key)) return
      given = reals_of(scene, "verification", 1, key)
      value = 0.0_dp
      value(:size(given)) = given
    end subroutine take_vector

  end subroutine set_up_solution

  !> How time is divided; the uniform rule takes the wave speed of the unstressed materials
  subroutine set_up_time(scene, s)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    real(dp) :: c
    integer :: m, n
    associate (t => s%time_options)
      t%end = real_of(scene, "time", 1, "end")
      t%courant = real_of(scene, "time", 1, "courant")
      t%growth = real_of(scene, "time", 1, "growth")
      t%smallest = real_of(scene, "time", 1, "smallest_step")
      t%max_steps = integer_of(scene, "time", 1, "max_steps")
      t%check = check_of_word(word_of(scene, "time", 1, "stability_check"))
      t%check_every = integer_of(scene, "time", 1, "stability_every")
      t%most_of_critical = real_of(scene, "time", 1, "stability_limit")
      t%redo = logical_of(scene, "time", 1, "redo_unstable_steps")
      c = 0.0_dp
      do m = 1, size(s%engine%laws)
        c = max(c, real(s%engine%laws(m)%law%initial_speed(), dp))
      end do
      s%rate = c
      select case (word_of(scene, "time", 1, "step_rule"))
      case ("uniform")
        t%rule = rule_uniform
        if (is_given(scene, "time", 1, "steps")) then
          n = integer_of(scene, "time", 1, "steps")
        else
          n = max(1, ceiling(t%end*c/(t%courant*t%reach*least_spacing(s%engine)) - 1.0e-9_dp))
        end if
        t%step = t%end/n
      case ("fixed")
        t%rule = rule_fixed
        t%step = real_of(scene, "time", 1, "step")
      case default
        t%rule = rule_adaptive
      end select
    end associate
  end subroutine set_up_time

end module gimp_setup
