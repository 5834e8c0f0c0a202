!> A checkpoint fits a scene that differs in nothing but what may change
program test_scene_compare
  use gimp_check, only: begin_suite, end_suite, check
  use gimp_error, only: error_t
  use gimp_scene, only: scene_t, parse_scene, echo_scene, scene_differences
  implicit none(type, external)
  character(len=1), parameter :: nl = new_line("a")
  character(len=*), parameter :: first = '&scene dimension = 2 title = "a" / &grid lower = 2*0 upper = 2*1 spacing = 0.1 /'//nl// &
    '&material name = "m" model = "neo_hookean" density = 1 young_modulus = 1 poisson_ratio = 0.3 /'//nl
  character(len=*), parameter :: box = '&body name = "b" material = "m" shape = "box" lower = 2*0.1 upper = 2*0.9 '
  character(len=*), parameter :: base = first//box//"/"//nl//"&time end = 1 /"
  call begin_suite("scene compare")
  call differ(base, "", "the same scene")
  call differ(first//box//"/"//nl//'&time end = 2 max_steps = 7 / &parallel threads = 3 / &output name = "n" every = 0.1 '// &
              'history_every = 3 overwrite = t progress = "off" / &restart every = 0.1 from = "x" /', "", "what may change")
  call differ('&scene dimension = 2 title = "another" / '//first(index(first, "&grid"):)//box//"/ &time end = 1 /", "", "the title")
  call differ(first//box//"velocity = 1, 0 / &time end = 1 /", "&body: velocity was 0.0, 0.0 ! m/s, is 1.0, 0.0 ! m/s", "a velocity")
  call differ(base//' &output fields = "mass" /', &
              '&output: fields was "displacement", "velocity", "stress", is "mass"', "the fields of frames")
  call differ(first//box//'/ &body name = "c" material = "m" shape = "sphere" center = 2*0.5 radius = 0.1 / &time end = 1 /', &
              '&body 2: name = "c" was not there; &body 2: material = "m" was not there; '// &
              '&body 2: shape = "sphere" was not there; and 10 more', "a body more")
  call differ("", "", "equal steps", uniform=1.0)
  call differ("", "&time: end was 2.0 ! s, is 1.0 ! s", "the end of equal steps", uniform=2.0)
  call end_suite()

contains

  !> Differences of `text` from the base, or of two scenes with equal steps that end at different times
  subroutine differ(text, expected, what, uniform)
    character(len=*), intent(in) :: text, expected, what
    real, intent(in), optional :: uniform !! end of the scene that was [s]
    character(len=:), allocatable :: was, is
    character(len=8) :: end
    if (present(uniform)) then
      write (end, "(f4.1)") uniform
      call complete(first//box//"/ &time step_rule = 'uniform' end = "//end//" /", was)
      call complete(first//box//"/ &time step_rule = 'uniform' end = 1 /", is)
    else
      call complete(base, was)
      call complete(text, is)
    end if
    call check(scene_differences(was, is), expected, what)
  end subroutine differ

  subroutine complete(text, whole)
    character(len=*), intent(in) :: text
    character(len=:), allocatable, intent(out) :: whole
    type(scene_t) :: scene
    type(error_t), allocatable :: error
    call parse_scene(text, scene, error)
    if (allocated(error)) error stop "the scene of the test is not sound"
    call echo_scene(scene, whole)
  end subroutine complete

end program test_scene_compare
