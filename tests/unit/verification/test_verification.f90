!> Exact solutions: numbers from independent evaluations, defaults, and what is refused
program test_verification
  use gimp_kinds, only: wp, lanes, pi
  use gimp_error, only: error_t, report_lines
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_exact_flat, only: lambert_w
  use gimp_verification, only: verification_t, verification_options_t, make_verification, exact_motion, exact_displacement, &
    exact_velocity, exact_stress, body_force, has_body_force, is_defined_at, error_scale, error_scale_text, expected_models
  implicit none(type, external)
  type(verification_t) :: v
  type(error_t), allocatable :: error
  real(wp), dimension(lanes, 3) :: x, u, vel, b
  real(wp) :: f(lanes, 9), sigma(lanes, 6)

  call begin_suite("verification")
  call manufactured_numbers()
  call column_numbers()
  call bar_numbers()
  call rigid_numbers()
  call scales()
  call refusals()
  call end_suite()

contains

  !> Numbers of the Python reference solutions (classes AxisAligned, Vortex, Ring of reference mms.py, their defaults),
  !> 17 digits; tolerance: a few units of round-off of the largest intermediate term
  subroutine manufactured_numbers()
    call evaluate("axis_aligned", 1, 1.0e7_wp, 0.3_wp, [0.3_wp, 0.0_wp, 0.0_wp], 0.0037_wp)
    call check(u(3, 1), 3.7123954442227977e-02_wp, 1.0e-16_wp, "axis-aligned 1D: displacement")
    call check(vel(3, 1), 5.0469590601748342_wp, 1.0e-13_wp, "axis-aligned 1D: velocity")
    call check(b(3, 1), 5.9326511677230008e+02_wp, 1.0e-11_wp, "axis-aligned 1D: body force")
    call check(sigma(3, 1), 1.0589437614590467e+06_wp, 1.0e-8_wp, "axis-aligned 1D: stress")
    call check(sigma(3, 4:6), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "axis-aligned 1D: no shear")

    call evaluate("axis_aligned", 2, 1.0e7_wp, 0.3_wp, [0.3_wp, 0.65_wp, 0.0_wp], 0.0037_wp)
    call check(u(3, 1:2), [3.7123954442227977e-02_wp, -4.0886267954424044e-02_wp], 1.0e-16_wp, "axis-aligned 2D: displacement")
    call check(vel(3, 1:2), [5.0469590601748342_wp, -5.5584412703242227_wp], 1.0e-13_wp, "axis-aligned 2D: velocity")
    call check(b(3, 1:2), [4.7937692717857425e+02_wp, -6.3797133424741628e+02_wp], 1.0e-11_wp, "axis-aligned 2D: body force")
    call check(f(3, [1, 2, 4, 5]), [1.0847354508318305_wp, 0.0_wp, 0.0_wp, 1.0654475244466610_wp], 1.0e-15_wp, &
      "axis-aligned 2D: F")
    call check(sigma(3, [1, 2, 4]), [1.3103540390196601e+06_wp, 1.1723373157768124e+06_wp, 0.0_wp], 1.0e-8_wp, &
      "axis-aligned 2D: stress")
    ! plane strain: sigma_zz = lambda ln J/J
    call check(sigma(3, 3), 1.0e7_wp*0.3_wp/(1.3_wp*0.4_wp)*log(f(3, 1)*f(3, 5))/(f(3, 1)*f(3, 5)), 1.0e-8_wp, &
      "axis-aligned 2D: stress out of plane")
    call check(u(3, 3), 0.0_wp, 0.0_wp, "axis-aligned 2D: nothing moves out of plane")

    ! with the third phase 0, at X_3 = 1/2 nothing is stretched along the third axis: the body force of 2D must come back
    call evaluate("axis_aligned", 3, 1.0e7_wp, 0.3_wp, [0.3_wp, 0.65_wp, 0.5_wp], 0.0037_wp)
    call check(b(3, 1:2), [4.7937692717857425e+02_wp, -6.3797133424741628e+02_wp], 1.0e-11_wp, &
      "axis-aligned 3D at X_3 = 1/2: body force of 2D")

    call evaluate("vortex", 2, 1.0e3_wp, 0.3_wp, [0.7_wp, -0.55_wp, 0.0_wp], 0.37_wp)
    call check(u(3, 1:2), [3.1617557469091340e-02_wp, 4.2815862232501445e-02_wp], 1.0e-15_wp, "vortex: displacement")
    call check(vel(3, 1:2), [4.1230580818766550e-02_wp, 5.9475473670050155e-02_wp], 1.0e-15_wp, "vortex: velocity")
    call check(b(3, 1:2), [-8.7051148115278920e-02_wp, -2.7803831836430920e-01_wp], 1.0e-14_wp, "vortex: body force")
    call check(f(3, [1, 2, 4, 5]), [1.2057762664998424_wp, -2.2284686972487824e-01_wp, 3.5917347051244541e-01_wp, &
      7.6296021241035195e-01_wp], 2.0e-15_wp, "vortex: F")
    call check(sigma(3, [1, 2, 4]), [1.9367582007710612e+02_wp, -1.1111005090722911e+02_wp, 1.0117675047692785e+02_wp], &
      2.0e-12_wp, "vortex: stress")

    call evaluate("expanding_ring", 2, 1.0e7_wp, 0.0_wp, [-0.31_wp, 0.42_wp, 0.0_wp], 0.0021_wp)
    call check(u(3, 1:2), [-3.6852667426146977e-02_wp, 4.9929420383812033e-02_wp], 1.0e-15_wp, "ring: displacement")
    call check(vel(3, 1:2), [-1.4925760910521980e+01_wp, 2.0221998652965262e+01_wp], 1.0e-12_wp, "ring: velocity")
    call check(b(3, 1:2), [2.6234153631236045e+03_wp, -3.5543046855223029e+03_wp], 1.0e-9_wp, "ring: body force")
    call check(f(3, [1, 2, 4, 5]), [1.0712423261266131_wp, 6.4540785195594919e-02_wp, 6.4540785195594974e-02_wp, &
      1.0314372182064422_wp], 2.0e-15_wp, "ring: F")
    call check(sigma(3, [1, 2, 4]), [6.8918975857625809e+05_wp, 3.0900758522892743e+05_wp, 6.1643485641124053e+05_wp], &
      2.0e-8_wp, "ring: stress")
  end subroutine manufactured_numbers

  !> Deformed heights of the column (reference exact.py: closed form and quadrature with scipy's Lambert W)
  subroutine column_numbers()
    call evaluate("self_weight_column", 2, 1.0e6_wp, 0.0_wp, [0.0_wp, 50.0_wp, 0.0_wp], 0.0_wp, "hencky", 80.0_wp)
    call check(50.0_wp + u(3, 2), 49.037991417676402_wp, 1.0e-11_wp, "column: top, Hencky (E/(rho0 g) times round-off)")
    call evaluate("self_weight_column", 2, 1.0e6_wp, 0.0_wp, [0.0_wp, 50.0_wp, 0.0_wp], 0.0_wp, "neo_hookean", 80.0_wp)
    call check(50.0_wp + u(3, 2), 49.013330135160487_wp, 1.0e-11_wp, "column: top, neo-Hookean")
    call evaluate("self_weight_column", 1, 1.0e6_wp, 0.0_wp, [37.5_wp, 0.0_wp, 0.0_wp], 0.0_wp, "hencky", 80.0_wp)
    call check(37.5_wp + u(3, 1), 36.599874623010507_wp, 1.0e-11_wp, "column: three quarters up, Hencky, 1D")
    call check(sigma(3, 1), -1.0e4_wp, 1.0e-9_wp, "column: stress is the weight above")
    call evaluate("self_weight_column", 3, 1.0e6_wp, 0.0_wp, [0.0_wp, 0.0_wp, 10.0_wp], 0.0_wp, "neo_hookean", 80.0_wp)
    call check(10.0_wp + u(3, 3), 9.646504516686530_wp, 1.0e-11_wp, "column: a fifth up, neo-Hookean, 3D")
    call evaluate("self_weight_column", 1, 1.0e6_wp, 0.0_wp, [50.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "linear_elastic", 80.0_wp)
    call check(50.0_wp + u(3, 1), 1250.0_wp*(1.0_wp - exp(-0.04_wp)), 1.0e-11_wp, "column: top, rate law")
    call check_true(.not. has_body_force(v), "column: gravity is left to the scene")
    ! scipy.special.lambertw
    call check(lambert_w(0.04_wp), 0.03848966594197857_wp, 1.0e-17_wp, "Lambert W(0.04)")
    call check(lambert_w(1.0_wp), 0.5671432904097838_wp, 2.0e-16_wp, "Lambert W(1)")
    call check(lambert_w(5.0_wp), 1.3267246652422002_wp, 4.0e-16_wp, "Lambert W(5)")
    call check(lambert_w(0.0_wp), 0.0_wp, 0.0_wp, "Lambert W(0)")
  end subroutine column_numbers

  !> The bar after a quarter of a period: stretched to the full amplitude, at rest
  subroutine bar_numbers()
    real(wp), parameter :: quarter = 2.5_wp !! L/c = 25 m/(10 m/s)
    call evaluate("vibrating_bar", 1, 100.0_wp, 0.0_wp, [25.0_wp, 0.0_wp, 0.0_wp], quarter, "linear_elastic", 1.0_wp)
    call check(v%omega, 0.2_wp*pi, 1.0e-15_wp, "bar: angular frequency pi c/(2 L)")
    call check(u(3, 1), 0.1_wp/(0.2_wp*pi), 1.0e-15_wp, "bar: tip at v0/omega after a quarter period")
    call check(vel(3, 1), 0.0_wp, 1.0e-16_wp, "bar: tip at rest then")
    call check(sigma(3, 1), 0.0_wp, 1.0e-14_wp, "bar: free end without stress")
    call evaluate("vibrating_bar", 1, 100.0_wp, 0.0_wp, [0.0_wp, 0.0_wp, 0.0_wp], quarter, "linear_elastic", 1.0_wp)
    call check(sigma(3, 1), 100.0_wp*0.1_wp/10.0_wp, 1.0e-13_wp, "bar: stress E v0/c at the wall")
    call check(sigma(3, 2:3), [0.0_wp, 0.0_wp], 0.0_wp, "bar: no stress across for nu = 0")
  end subroutine bar_numbers

  !> Rigid motions: a quarter turn and a shift
  subroutine rigid_numbers()
    type(verification_options_t) :: options
    integer :: p
    options = verification_options_t(solution="rigid_rotation")
    options%angular_velocity(3) = 2.0_wp*pi
    options%center(1:2) = [0.5_wp, 0.5_wp]
    call make_verification(options, 2, "neo_hookean", 1.0e3_wp, 1.0e6_wp, 0.3_wp, v, error)
    call check_true(.not. allocated(error), "rotation: is accepted")
    x = 0.0_wp
    do p = 1, lanes
      x(p, 1:2) = [0.5_wp + 0.03_wp*p, 0.5_wp]
    end do
    call exact_motion(v, 0.25_wp, x, u, vel, f)
    call check(x(8, 1:2) + u(8, 1:2), [0.5_wp, 0.74_wp], 1.0e-15_wp, "rotation: a quarter turn")
    call check(vel(8, :), [-0.48_wp*pi, 0.0_wp, 0.0_wp], 1.0e-15_wp, "rotation: velocity w x r")
    call check(f(8, :), real([0, -1, 0, 1, 0, 0, 0, 0, 1], wp), 1.0e-15_wp, "rotation: F is the rotation")
    options = verification_options_t(solution="rigid_translation")
    options%velocity(1:2) = [0.7_wp, -0.3_wp]
    call make_verification(options, 2, "hencky", 1.0e3_wp, 1.0e6_wp, 0.3_wp, v, error)
    call exact_motion(v, 3.0_wp, x, u, vel, f)
    call exact_stress(v, 3.0_wp, x, sigma)
    call check(u(5, :), [2.1_wp, -0.9_wp, 0.0_wp], 1.0e-15_wp, "translation: X + v t")
    call check(sum(abs(sigma)), 0.0_wp, 0.0_wp, "translation: no stress")
  end subroutine rigid_numbers

  !> By what errors are divided, and where a solution exists
  subroutine scales()
    call evaluate("expanding_ring", 2, 1.0e7_wp, 0.0_wp, [0.5_wp, 0.0_wp, 0.0_wp], 0.0_wp)
    call check(error_scale(v), 0.1_wp, 0.0_wp, "ring: errors by the amplitude")
    call check_true(has_body_force(v), "ring: needs its body force")
    call check_true(is_defined_at(v, [0.6_wp, 0.0_wp, 0.0_wp]) .and. .not. is_defined_at(v, [0.0_wp, 0.39_wp, 0.0_wp]), &
      "ring: exists on its faces, not inside the hole")
    call evaluate("vortex", 2, 1.0e3_wp, 0.3_wp, [0.0_wp, 0.0_wp, 0.0_wp], 0.2_wp)
    call check(error_scale(v), 1.0_wp, 0.0_wp, "vortex: absolute errors")
    call check(sum(abs(b)) + sum(abs(u)), 0.0_wp, 0.0_wp, "vortex: at rest off the ring, also in its centre")
    call evaluate("vibrating_bar", 1, 100.0_wp, 0.0_wp, [1.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "linear_elastic", 1.0_wp)
    call check(error_scale(v), 0.5_wp/pi, 1.0e-15_wp, "bar: errors by v0/omega")
    call check(error_scale_text(v), "v0/omega = 0.159155 m", "bar: scale in words")
    call check(expected_models(v), "neo_hookean hencky linear_elastic", "bar: any elastic law")
  end subroutine scales

  !> Wrong scenes are refused, each mistake with its own line
  subroutine refusals()
    type(verification_options_t) :: options
    options = verification_options_t(solution="axis_alined")
    call make_verification(options, 2, "neo_hookean", 1.0_wp, 1.0_wp, 0.0_wp, v, error)
    call check_true(index(error%message, "axis_alined") > 0, "unknown solution is named")
    options = verification_options_t(solution="axis_aligned", amplitude=0.4_wp, gravity=9.81_wp)
    call make_verification(options, 2, "hencky", 1.0_wp, 1.0_wp, 0.0_wp, v, error)
    call check(report_lines(error), 3, "amplitude too large, key not read, wrong model: three messages")
    call check_true(index(error%message, "key gravity is not read by solution axis_aligned") > 0, "the key is named")
    options = verification_options_t(solution="expanding_ring")
    call make_verification(options, 2, "neo_hookean", 1.0_wp, 1.0_wp, 0.3_wp, v, error)
    call check(error%message, &
      "&verification: solution expanding_ring needs poisson_ratio = 0, the material has 0.3", "ring with nu = 0.3")
    call make_verification(options, 1, "neo_hookean", 1.0_wp, 1.0_wp, 0.0_wp, v, error)
    call check_true(allocated(error), "ring in 1D")
    options%outer_radius = 1.2_wp
    call make_verification(options, 2, "neo_hookean", 1.0_wp, 1.0_wp, 0.0_wp, v, error)
    call check_true(allocated(error), "ring with radii as 1 to 3")
    options = verification_options_t(solution="rigid_translation")
    call make_verification(options, 2, "hencky", 1.0_wp, 1.0_wp, 0.0_wp, v, error)
    call check(error%message, "&verification: velocity is required by solution rigid_translation", "translation without velocity")
    options = verification_options_t(solution="rigid_rotation", angular_velocity=[1.0_wp, 0.0_wp, 0.0_wp])
    call make_verification(options, 2, "hencky", 1.0_wp, 1.0_wp, 0.0_wp, v, error)
    call check_true(allocated(error), "rotation out of the plane")
    options = verification_options_t(solution="axis_aligned", phases=[0.0_wp, 1.0_wp, 2.0_wp])
    call make_verification(options, 2, "neo_hookean", 1.0_wp, 1.0_wp, 0.0_wp, v, error)
    call check_true(allocated(error), "more phases than dimensions")
  end subroutine refusals

  !> All quantities of a solution with default numbers at one point (lane 3) and time
  subroutine evaluate(solution, dim, young, poisson, point, t, model, density)
    character(len=*), intent(in) :: solution
    integer, intent(in) :: dim
    real(wp), intent(in) :: young, poisson, point(3), t
    character(len=*), intent(in), optional :: model
    real(wp), intent(in), optional :: density
    type(verification_options_t) :: options
    character(len=:), allocatable :: law
    real(wp) :: rho
    law = "neo_hookean"
    if (present(model)) law = model
    rho = 1.0e3_wp
    if (present(density)) rho = density
    options%solution = solution
    call make_verification(options, dim, law, rho, young, poisson, v, error)
    call check_true(.not. allocated(error), solution//" is accepted")
    x = 0.0_wp
    x(3, :) = point
    call exact_motion(v, t, x, u, vel, f)
    call exact_stress(v, t, x, sigma)
    call body_force(v, t, x, b)
  end subroutine evaluate

end program test_verification
