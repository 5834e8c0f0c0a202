!> The complete scene reads back as the same scene, in all dimensions and with every group
program test_scene_echo
  use gimp_common_kinds, only: dp
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_error, only: error_t
  use gimp_text, only: word_in
  use gimp_scene, only: scene_t, parse_scene, echo_scene, real_of, reals_of, text_of_key, count_groups, is_given, word_of
  implicit none(type, external)
  character(len=1), parameter :: nl = new_line("a")
  character(len=*), parameter :: ending = &
    '&material name = "a ""b"" / c" model = "hencky_von_mises" density = 1000.1 young_modulus = 0.1e7 poisson_ratio = 0.3 '// &
    '  yield_stress = 1e5 hardening = "power" hardening_strain = 0.01 /'//nl// &
    '&material name = "soil" model = "drucker_prager" density = 2000 young_modulus = 1e7 poisson_ratio = 0.333333333333333315'// &
    ' friction_angle = 30 /'//nl// &
    '&output every = 0.01 fields = "stress", "mass" csv = t probes = 12*0.5 /'//nl// &
    '&load kind = "pressure" body = "one" pressure = 1e5 face = "all" times = 0, 0.1, 0.2 factors = 0, 1, 1 /'//nl// &
    '&load kind = "pressure" body = "one" pressure = -1e5 face = "x_low" ramp_time = 0.1 /'//nl// &
    '&boundary side = "x_low" condition = "free" leaving = "remove" /'//nl
  character(len=*), parameter :: cube = '&body name = "one" material = "soil" shape = "box" '

  call begin_suite("scene echo")
  call round_trip("&scene dimension = 1 / &grid lower = 0 upper = 1 spacing = 0.125 / &time end = 1 /"//nl//ending// &
                  cube//"lower = 0.1 upper = 0.9 /"//nl//'&verification solution = "vibrating_bar" length = 1 /', "1D")
  call round_trip('&scene dimension = 2 title = "it''s 50 % ! & /" / &grid lower = 2*0 upper = 2*1 spacing = 0.1 /'//nl// &
                  '&time end = 1 step_rule = "uniform" steps = 7 /'//nl//ending//cube// &
                  'lower = 2*0.1 upper = 2*0.9 initial = "verification" / &verification solution = "vortex" /'//nl// &
                  '&body name = "hole" operation = "subtract" shape = "polygon" points = 0, 0, 1, 0, 0, 1 /'//nl// &
                  '&body name = "ring" material = "soil" shape = "ring" center = 2*0.5 inner_radius = 0.1 '// &
                  'outer_radius = 0.2 fill = "polar" radial_particles = 4 angular_particles = 9 /'//nl// &
                  '&method basis = "linear" damping = "local" transfer = "pic" /', "2D")
  call round_trip('&scene dimension = 3 / &grid lower = 3*-1 upper = 3*1 spacing = 0.1 / &time end = 1 step_rule = "fixed" '// &
                  'step = 0.1 /'//nl//ending//cube//'lower = 3*0.1 upper = 3*0.9 angular_velocity = 1, 2, 3 '// &
                  'cut_point = 3*0.5 cut_normal = 0, 0, 1 rotation_center = 3*0.123456789012345678 /'//nl// &
                  '&body name = "rod" material = "soil" shape = "cylinder" axis = "x" center = 3*0.5 radius = 0.1 '// &
                  'axis_lower = 0.1 axis_upper = 0.9 /'//nl//'&boundary side = "z_low" condition = "velocity" '// &
                  'velocity = 0, 0, 1 times = 0, 1 factors = 0, 1 /', "3D")
  call round_trip('&scene dimension = 2 / &mesh file = "/dev/null" search_rule = "component" / &time end = 1 /'//nl// &
                  '&material name = "sand" model = "neo_hookean" density = 1 young_modulus = 1 poisson_ratio = 0 /'//nl// &
                  '&body name = "one" material = "sand" shape = "elements" group = "Soil, wet" particles_per_axis = 3 /'//nl// &
                  '&boundary side = "Inner wall" condition = "slip" / &boundary side = "outer" condition = "free" leaving = "remove" /'//nl// &
                  '&load kind = "pressure" side = "Inner wall" pressure = 1e5 / &method basis = "cpdi" /', "on a mesh")
  call test_long_list()
  call test_what_is_echoed()
  call end_suite()

contains

  !> Echo, read, echo again: the same text; every real the same bits
  subroutine round_trip(text, what)
    character(len=*), intent(in) :: text, what
    type(scene_t) :: scene, again
    type(error_t), allocatable :: error
    character(len=:), allocatable :: first, second
    integer :: k
    call parse_scene(text, scene, error)
    if (allocated(error)) call check(error%message, "", "the scene is sound, "//what)
    call echo_scene(scene, first)
    call parse_scene(first, again, error)
    if (allocated(error)) call check(error%message, "", "the complete scene is sound, "//what)
    call echo_scene(again, second)
    call check(second, first, "echoed again, "//what)
    do k = 1, size(scene%group)
      if (count_groups(scene, trim(scene%group(k)%name)) == 0) cycle
      if (scene%group(k)%name == "boundary" .and. count_groups(scene, "mesh") > 0) &
        call check(text_of_key(again, "boundary", 1, "side"), "Inner wall", "names of sides keep their letters")
      call check(count_groups(again, trim(scene%group(k)%name)), count_groups(scene, trim(scene%group(k)%name)), &
                 "number of &"//trim(scene%group(k)%name)//", "//what)
    end do
    call check(real_of(again, "material", 2, "poisson_ratio"), real_of(scene, "material", 2, "poisson_ratio"), 0.0_dp, &
               "a number with all its digits, "//what)
    call check(reals_of(again, "body", 1, "velocity"), reals_of(scene, "body", 1, "velocity"), 0.0_dp, "velocity, "//what)
    call check(text_of_key(again, "material", 1, "name"), text_of_key(scene, "material", 1, "name"), "quotes, "//what)
    call check(text_of_key(again, "scene", 1, "title"), text_of_key(scene, "scene", 1, "title"), "title, "//what)
    call check(word_of(again, "scene", 1, "kinematics"), word_of(scene, "scene", 1, "kinematics"), "kinematics, "//what)
    call check_true(is_given(again, "method", 1, "kernel"), "an absent group is written out, "//what)
    call check_true(longest_line(first) <= 132, "lines stay short, "//what)
  end subroutine round_trip

  pure integer function longest_line(text)
    character(len=*), intent(in) :: text
    integer :: k, first
    longest_line = 0
    first = 1
    do k = 1, len(text)
      if (text(k:k) /= nl) cycle
      longest_line = max(longest_line, k - first)
      first = k + 1
    end do
  end function longest_line

  !> A polygon of 200 corners goes over many lines and comes back whole
  subroutine test_long_list()
    type(scene_t) :: scene, again
    type(error_t), allocatable :: error
    character(len=:), allocatable :: text
    character(len=32) :: point
    integer :: k
    text = ""
    do k = 1, 200
      write (point, "(2(f9.6, a))") 0.5_dp + 0.3_dp*cos(0.0314_dp*k), ",", 0.5_dp + 0.3_dp*sin(0.0314_dp*k), ","
      text = text//trim(point)
    end do
    call parse_scene('&scene dimension = 2 / &grid lower = 2*0 upper = 2*1 spacing = 0.1 / &time end = 1 /'// &
                     '&material name = "m" model = "hencky" density = 1 young_modulus = 1 poisson_ratio = 0 /'// &
                     '&body name = "b" material = "m" shape = "polygon" points = '//text//' /', scene, error)
    call check_true(.not. allocated(error), "a polygon of 200 corners")
    call echo_scene(scene, text)
    call check_true(longest_line(text) <= 132, "a long list is broken into lines")
    call parse_scene(text, again, error)
    call check(reals_of(again, "body", 1, "points"), reals_of(scene, "body", 1, "points"), 0.0_dp, "its corners")
  end subroutine test_long_list

  !> Only what is read stands in the complete scene
  subroutine test_what_is_echoed()
    type(scene_t) :: scene
    type(error_t), allocatable :: error
    character(len=:), allocatable :: text
    call parse_scene('&scene dimension = 2 / &grid lower = 2*0 upper = 2*1 spacing = 0.1 / &time end = 1 /'// &
                     '&material name = "m" model = "hencky" density = 1 young_modulus = 1 poisson_ratio = 0 /'// &
                     '&body name = "b" material = "m" shape = "box" lower = 2*0.1 upper = 2*0.9 /', scene, error)
    call echo_scene(scene, text)
    call check_true(index(text, "  courant = 0.4"//nl) > 0, "a default is written")
    call check_true(index(text, "  basis = ""cpgimp""") > 0, "also of an absent group")
    call check_true(index(text, "&verification") == 0 .and. index(text, "&load") == 0, "no group out of nothing")
    call check_true(index(text, "yield_stress") == 0 .and. index(text, "radius") == 0, "nothing that is not read")
    call check_true(index(text, "steps =") == index(text, "max_steps =") + 4, "no default that only the program can work out")
  end subroutine test_what_is_echoed

end program test_scene_echo
