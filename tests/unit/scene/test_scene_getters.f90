!> What a sound scene answers: values as written, defaults, lines
program test_scene_getters
  use gimp_common_kinds, only: dp, pi
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_error, only: error_t
  use gimp_scene, only: scene_t, parse_scene, count_groups, is_given, line_of, complain, real_of, reals_of, integer_of, &
                        integers_of, logical_of, word_of, text_of_key, texts_of
  implicit none(type, external)
  character(len=1), parameter :: nl = new_line("a")
  character(len=*), parameter :: rest = nl// &
    '&material name = "Steel" model = "hencky_von_mises" density = 1d3 young_modulus = 1.0e4 poisson_ratio = 0.3'//nl// &
    '  yield_stress = 12.5 /'//nl// &
    '&material name = "soil" model = "drucker_prager" density = 2000 young_modulus = 1e7 poisson_ratio = .25'// &
    ' friction_angle = 30 /'//nl//'&time end = 2.5 /'//nl
  type(scene_t) :: scene
  type(error_t), allocatable :: error

  call begin_suite("scene getters")
  call test_written()
  call test_defaults()
  call test_dimensions()
  call test_by_solution()
  call test_complain()
  call end_suite()

contains

  subroutine read_text(text)
    character(len=*), intent(in) :: text
    call parse_scene(text, scene, error)
    if (allocated(error)) call check(error%message, "", "the scene is sound")
  end subroutine read_text

  subroutine read_2d(extra)
    character(len=*), intent(in) :: extra
    call read_text('&scene title = "A title" DIMENSION = 2 /'//nl// &
                   '&grid lower = -1.0, 0.0 upper = 2*1.0 spacing = 0.5 /'//rest// &
                   '&body name = "one" material = "Steel" shape = "BOX" lower = 2*0.1 upper = 2*0.4'//nl// &
                   '  particles_per_axis = 3 /'//nl// &
                   '&body name = "two" material = "soil" shape = "sphere" center = 0.7, 0.7 radius = 0.2'// &
                   ' particles_per_axis = 2, 4 velocity = 1.0, -2.0e-3 angular_velocity = 0.5 /'//nl//extra)
  end subroutine read_2d

  subroutine test_written()
    call read_2d('&output fields = "mass" "DENSITY", csv = T name = "Run_1" probes = 0.1, 0.2, 0.3, 0.4 /')
    call check(count_groups(scene, "body"), 2, "bodies")
    call check(count_groups(scene, "load"), 0, "no load")
    call check(text_of_key(scene, "scene", 1, "title"), "A title", "a text as written")
    call check(integer_of(scene, "scene", 1, "dimension"), 2, "a key in capital letters")
    call check(scene%dimension, 2, "dimension of the scene")
    call check(reals_of(scene, "grid", 1, "lower"), [-1.0_dp, 0.0_dp], 0.0_dp, "a list")
    call check(reals_of(scene, "grid", 1, "upper"), [1.0_dp, 1.0_dp], 0.0_dp, "a repeated value")
    call check(real_of(scene, "material", 1, "density"), 1000.0_dp, 0.0_dp, "a number with d")
    call check(real_of(scene, "material", 2, "density"), 2000.0_dp, 0.0_dp, "a whole number as a real, second group")
    call check(text_of_key(scene, "material", 1, "name"), "Steel", "a name keeps its capitals")
    call check(word_of(scene, "body", 1, "shape"), "box", "a word loses its capitals")
    call check(size(integers_of(scene, "body", 1, "particles_per_axis")), 2, "one number for all axes")
    call check(sum(integers_of(scene, "body", 1, "particles_per_axis")), 6, "one number for all axes")
    call check(minval(integers_of(scene, "body", 2, "particles_per_axis")), 2, "a number per axis")
    call check(reals_of(scene, "body", 2, "velocity"), [1.0_dp, -2.0e-3_dp], 0.0_dp, "velocity")
    call check_true(logical_of(scene, "output", 1, "csv"), "a logical")
    call check(size(texts_of(scene, "output", 1, "fields")), 2, "a list of words")
    call check(trim(texts_of_nth(2)), "density", "second word")
    call check(size(reals_of(scene, "output", 1, "probes")), 4, "probes")
    call check_true(is_given(scene, "output", 1, "csv") .and. .not. is_given(scene, "output", 1, "every"), "what is given")
    call check_true(.not. is_given(scene, "body", 1, "velocity") .and. is_given(scene, "body", 2, "velocity"), "given where")
    call check(line_of(scene, "material", 1, "yield_stress"), 4, "line of a key")
    call check(line_of(scene, "material", 2, "cone"), 5, "line of the group of a key that is not written")
    call check(line_of(scene, "load", 1, "kind"), 0, "no line for an absent group")
    call check_true(index(scene%original, "DIMENSION = 2") > 0, "the text as read is kept")
  end subroutine test_written

  pure function texts_of_nth(n) result(text)
    integer, intent(in) :: n
    character(len=64) :: text
    character(len=64), allocatable :: all(:)
    allocate (all, source=texts_of(scene, "output", 1, "fields"))
    text = all(n)
  end function texts_of_nth

  subroutine test_defaults()
    call read_2d("")
    call check(count_groups(scene, "method"), 0, "no &method")
    call check(word_of(scene, "method", 1, "basis"), "cpgimp", "default word of an absent group")
    call check(real_of(scene, "method", 1, "flip_fraction"), 0.95_dp, 0.0_dp, "default number of an absent group")
    call check_true(logical_of(scene, "method", 1, "half_step_start"), "default logical")
    call check(text_of_key(scene, "output", 1, "name"), "gimp", "default text")
    call check(trim(texts_of_nth(3)), "stress", "default list of words")
    call check(integer_of(scene, "output", 1, "history_every"), 10, "default whole number")
    call check(real_of(scene, "time", 1, "courant"), 0.4_dp, 0.0_dp, "default number")
    call check(word_of(scene, "material", 1, "hardening"), "none", "default word of a model")
    call check(real_of(scene, "material", 1, "cohesion"), 0.0_dp, 0.0_dp, "default of a key that is not read")
    call check(reals_of(scene, "body", 1, "velocity"), [0.0_dp, 0.0_dp], 0.0_dp, "a default for each axis")
    call check(size(reals_of(scene, "body", 1, "velocity_gradient")), 4, "a default tensor")
    call check(size(reals_of(scene, "body", 1, "angular_velocity")), 1, "one spin in 2D")
    call check(size(reals_of(scene, "body", 1, "rotation_center")), 0, "no default to tell")
    call check_true(.not. is_given(scene, "body", 1, "rotation_center"), "and not given")
    call check(size(reals_of(scene, "output", 1, "probes")), 0, "no probes")
  end subroutine test_defaults

  !> Defaults that follow the dimension
  subroutine test_dimensions()
    integer :: d, k
    character(len=*), parameter :: fitting(3) = [character(len=15) :: "uniaxial_strain", "plane_strain", "full"]
    character(len=1), parameter :: digit(3) = ["1", "2", "3"]
    real(dp), allocatable :: f(:)
    do d = 1, 3
      call read_text("&scene dimension = "//digit(d)//" / &grid lower = "//digit(d)//"*0 upper = "//digit(d)// &
                     "*1 spacing = 0.25 /"//rest//'&body name = "b" material = "soil" shape = "box" lower = '//digit(d)// &
                     "*0.25 upper = "//digit(d)//'*0.75 initial = "rest" / &verification solution = "axis_aligned" /')
      call check(text_of_key(scene, "scene", 1, "title"), "", "an empty default")
      call check(word_of(scene, "scene", 1, "kinematics"), trim(fitting(d)), "kinematics in "//digit(d)//"D")
      call check(size(reals_of(scene, "body", 1, "velocity")), d, "velocity in "//digit(d)//"D")
      f = reals_of(scene, "body", 1, "deformation_gradient")
      call check(size(f), d*d, "deformation gradient in "//digit(d)//"D")
      call check(sum(f), real(d, dp), 0.0_dp, "its trace and nothing beside")
      call check(sum([(f((k - 1)*d + k), k=1, d)]), real(d, dp), 0.0_dp, "identity in "//digit(d)//"D")
      call check(size(integers_of(scene, "body", 1, "particles_per_axis")), d, "particles per axis in "//digit(d)//"D")
      f = reals_of(scene, "verification", 1, "phases")
      call check(size(f), d, "phases in "//digit(d)//"D")
      if (d > 1) call check(f(2), pi, epsilon(pi), "second phase is pi, to the last bit but one")
      call check(size(reals_of(scene, "verification", 1, "center")), d, "centre in "//digit(d)//"D")
    end do
    call check(size(reals_of(scene, "body", 1, "angular_velocity")), 3, "three spins in 3D")
  end subroutine test_dimensions

  !> Defaults that follow a word
  subroutine test_by_solution()
    call read_2d('&verification solution = "vortex" /')
    call check(real_of(scene, "verification", 1, "amplitude"), 0.1_dp, 0.0_dp, "amplitude of the vortex")
    call check(real_of(scene, "verification", 1, "outer_radius"), 1.25_dp, 0.0_dp, "outer radius of the vortex")
    call read_2d('&verification solution = "expanding_ring" /')
    call check(real_of(scene, "verification", 1, "inner_radius"), 0.4_dp, 0.0_dp, "inner radius of the ring")
    call read_2d('&verification solution = "axis_aligned" /')
    call check(real_of(scene, "verification", 1, "amplitude"), 0.05_dp, 0.0_dp, "amplitude of the axis-aligned motion")
    call check(real_of(scene, "verification", 1, "period"), 1.0_dp, 0.0_dp, "default of a key that is not read")
  end subroutine test_by_solution

  !> Messages of those who find a mistake later
  subroutine test_complain()
    type(error_t), allocatable :: late
    call read_2d("")
    call complain(late, scene, "body", 2, "radius", "holds no particle")
    call check(late%message, "line 9: &body: radius = 0.2; holds no particle", "a key as written")
    deallocate (late)
    call complain(late, scene, "body", 2, "fill", "is odd")
    call check(late%message, "line 9: &body: fill = cartesian (default); is odd", "a default")
    deallocate (late)
    call complain(late, scene, "body", 1, "rotation_center", "is wanted")
    call check(late%message, "line 7: &body: rotation_center is not set; is wanted", "neither")
    deallocate (late)
    call complain(late, scene, "body", 1, "", "is empty")
    call complain(late, scene, "method", 1, "basis", "does not fit")
    call check(late%message, "line 7: &body: is empty"//nl//"&method: basis = cpgimp (default); does not fit", &
               "a group, and a group that is absent")
  end subroutine test_complain

end program test_scene_getters
