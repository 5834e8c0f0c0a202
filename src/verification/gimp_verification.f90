!> Exact solutions: where a body should be, how fast, how strained and stressed, and the body force that makes it so.
!>
!> | solution | law | body force | default numbers |
!> |---|---|---|---|
!> | vibrating_bar | any, at small strain; nu = 0 unless 1D | no | v0 0.1 m/s, L 25 m |
!> | axis_aligned (1D, 2D, 3D) | neo-Hookean | yes | A 0.05 m, phases 0; 0, pi; 0, pi, 0 |
!> | vortex (2D; 3D about z) | neo-Hookean | yes | A 0.1 rad, T 1 s, radii 0.75, 1.25 m |
!> | expanding_ring (2D; 3D about z) | neo-Hookean, nu = 0 | yes | A 0.1 m, radii 0.4, 0.6 m |
!> | self_weight_column | neo-Hookean, Hencky or linear_elastic, nu = 0 | no: the scene's gravity | l0 50 m, g 10 m/s2 |
!> | rigid_translation | any | no | velocity required |
!> | rigid_rotation | any; a stiff body | no | angular velocity required |
!>
!> All of them are functions of the reference position X and the time t, in coordinates from `center` (default 0).
!> The axis-aligned vibration lives in the unit line, square or cube; the bar along the first axis; the column along the last.
!> Neo-Hookean: sigma = [lambda ln J I + mu (F F^T - I)]/J, plane strain in 2D, uniaxial strain in 1D.
module gimp_verification
  use gimp_kinds, only: dp, lanes, pi
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of, word_in, nth_word
  use gimp_verification_types, only: verification_t, verification_options_t, unset, is_set, solution_words, &
    vibrating_bar, axis_aligned, vortex, expanding_ring, self_weight_column, rigid_translation, rigid_rotation, &
    law_neo_hookean, law_hencky, law_rate, law_other
  use gimp_exact_flat, only: bar_motion, axis_aligned_motion, axis_aligned_force, column_motion, translation_motion, &
    rotation_motion
  use gimp_exact_round, only: vortex_motion, vortex_force, ring_motion, ring_force, set_ring_polynomial
  implicit none(type, external)
  private
  public :: verification_t, verification_options_t, unset, solution_words
  public :: make_verification, expected_models, solution_name
  public :: exact_motion, exact_displacement, exact_velocity, exact_deformation, exact_stress, body_force
  public :: has_body_force, is_defined_at, error_scale, error_scale_text

  !> The options of a solution by name, in the order in which they are asked about
  character(len=*), parameter :: option_words = &
    "amplitude speed length period gravity inner_radius outer_radius velocity angular_velocity center phases"

contains

  !> Set up a solution from what the scene says and from the material of the body; tells every mistake at once
  pure subroutine make_verification(options, dim, model, density, young, poisson, verification, error)
    type(verification_options_t), intent(in) :: options
    integer, intent(in) :: dim !! 1, 2 or 3
    character(len=*), intent(in) :: model !! word of the material model
    real(dp), intent(in) :: density, young, poisson !! of the material [kg/m3, Pa, -]
    type(verification_t), intent(out) :: verification
    type(error_t), allocatable, intent(out) :: error
    verification%solution = word_in(options%solution, solution_words)
    if (verification%solution == 0) then
      call add_error(error, "&verification: solution = '"//trim(options%solution)//"'; must be one of "//solution_words)
      return
    end if
    associate (v => verification)
      v%dim = dim
      v%density = density
      v%young = young
      v%poisson = poisson
      v%lambda = young*poisson/((1.0_dp + poisson)*(1.0_dp - 2.0_dp*poisson))
      v%mu = 0.5_dp*young/(1.0_dp + poisson)
      v%wave_speed = sqrt(young/density)
      v%law = law_of(model)
      call check_options(options, v%solution, dim, error)
      call check_material(v, model, error)
      v%center = chosen(options%center, 0.0_dp)
      v%velocity = chosen(options%velocity, 0.0_dp)
      v%angular_velocity = chosen(options%angular_velocity, 0.0_dp)
    end associate
    select case (verification%solution)
    case (vibrating_bar)
      call make_bar(options, verification, error)
    case (axis_aligned)
      call make_axis_aligned(options, verification, error)
    case (vortex, expanding_ring)
      call make_round(options, verification, error)
    case (self_weight_column)
      verification%length = chosen(options%length, 50.0_dp)
      verification%gravity = chosen(options%gravity, 10.0_dp)
      call check_positive("length", verification%length, error)
      call check_positive("gravity", verification%gravity, error)
    end select
  end subroutine make_verification

  !> Speed, length, frequency of the bar
  pure subroutine make_bar(options, v, error)
    type(verification_options_t), intent(in) :: options
    type(verification_t), intent(inout) :: v
    type(error_t), allocatable, intent(inout) :: error
    v%speed = chosen(options%speed, 0.1_dp)
    v%length = chosen(options%length, 25.0_dp)
    call check_positive("speed", v%speed, error)
    call check_positive("length", v%length, error)
    if (allocated(error)) return
    v%wave_speed = sqrt((v%lambda + 2.0_dp*v%mu)/v%density) ! uniaxial strain; sqrt(E/rho0) for nu = 0
    v%wave_number = 0.5_dp*pi/v%length
    v%omega = v%wave_number*v%wave_speed
    v%amplitude = v%speed/v%omega
  end subroutine make_bar

  !> Amplitude and phases of the axis-aligned vibration
  pure subroutine make_axis_aligned(options, v, error)
    type(verification_options_t), intent(in) :: options
    type(verification_t), intent(inout) :: v
    type(error_t), allocatable, intent(inout) :: error
    v%amplitude = chosen(options%amplitude, 0.05_dp)
    v%wave_number = pi
    v%omega = pi*v%wave_speed
    v%phases = [0.0_dp, pi, 0.0_dp]
    where (is_set(options%phases)) v%phases = options%phases
    call check_positive("amplitude", v%amplitude, error)
    if (v%amplitude*pi >= 1.0_dp) call add_error(error, "&verification: amplitude = "//text_of(v%amplitude) &
      //" m; must be below 1/pi m, or the body turns inside out")
  end subroutine make_axis_aligned

  !> Radii, amplitude and frequency of vortex and ring
  pure subroutine make_round(options, v, error)
    type(verification_options_t), intent(in) :: options
    type(verification_t), intent(inout) :: v
    type(error_t), allocatable, intent(inout) :: error
    real(dp) :: steepest, ri, ro
    if (v%dim < 2) call add_error(error, "&verification: solution "//solution_name(v)//" needs dimension 2 or 3")
    v%amplitude = chosen(options%amplitude, 0.1_dp)
    v%inner_radius = chosen(options%inner_radius, merge(0.75_dp, 0.4_dp, v%solution == vortex))
    v%outer_radius = chosen(options%outer_radius, merge(1.25_dp, 0.6_dp, v%solution == vortex))
    v%period = chosen(options%period, 1.0_dp)
    call check_positive("amplitude", v%amplitude, error)
    call check_positive("inner_radius", v%inner_radius, error)
    call check_positive("period", v%period, error)
    if (v%outer_radius <= v%inner_radius) call add_error(error, "&verification: outer_radius = " &
      //text_of(v%outer_radius)//" m; must be above inner_radius")
    if (allocated(error)) return
    if (v%solution == vortex) then
      v%omega = pi/v%period
      return
    end if
    ri = v%inner_radius
    ro = v%outer_radius
    if (abs(ro - 3.0_dp*ri) < 1.0e-6_dp*ro) then
      call add_error(error, "&verification: outer_radius is three times inner_radius, where the ring has no solution")
      return
    end if
    v%omega = pi*v%wave_speed/(ri + ro)
    call set_ring_polynomial(v)
    ! u_R' = 3 c3 (R - Ri)(R - Ro) is steepest at the mid radius; u_R/R is monotone or bounded by its ends and that slope
    steepest = max(0.75_dp*abs(v%ring_c3)*(ro - ri)**2, abs(v%ring_c1 + ri*(v%ring_c2 + ri*v%ring_c3)), 1.0_dp/ro)
    if (v%amplitude*steepest >= 1.0_dp) call add_error(error, "&verification: amplitude = "//text_of(v%amplitude) &
      //" m; must be below "//text_of(1.0_dp/steepest)//" m, or the ring turns inside out")
  end subroutine make_round

  !> The number given, or the default
  elemental real(dp) function chosen(value, default)
    real(dp), intent(in) :: value, default
    chosen = default
    if (is_set(value)) chosen = value
  end function chosen

  !> One complaint if a number is not above zero
  pure subroutine check_positive(name, value, error)
    character(len=*), intent(in) :: name
    real(dp), intent(in) :: value
    type(error_t), allocatable, intent(inout) :: error
    if (.not. value > 0.0_dp) call add_error(error, "&verification: "//name//" = "//text_of(value)//"; must be above 0")
  end subroutine check_positive

  !> Numbers that the solution does not read, and numbers that it needs
  pure subroutine check_options(options, solution, dim, error)
    type(verification_options_t), intent(in) :: options
    integer, intent(in) :: solution, dim
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: reads
    logical :: given(11)
    integer :: k
    given = [is_set(options%amplitude), is_set(options%speed), is_set(options%length), is_set(options%period), &
      is_set(options%gravity), is_set(options%inner_radius), is_set(options%outer_radius), any(is_set(options%velocity)), &
      any(is_set(options%angular_velocity)), any(is_set(options%center)), any(is_set(options%phases))]
    select case (solution)
    case (vibrating_bar)
      reads = "speed length center"
    case (axis_aligned)
      reads = "amplitude phases center"
    case (vortex)
      reads = "amplitude period inner_radius outer_radius center"
    case (expanding_ring)
      reads = "amplitude inner_radius outer_radius center"
    case (self_weight_column)
      reads = "length gravity center"
    case (rigid_translation)
      reads = "velocity"
      if (.not. given(8)) call add_error(error, "&verification: velocity is required by solution rigid_translation")
    case default
      reads = "angular_velocity center"
      if (.not. given(9)) call add_error(error, "&verification: angular_velocity is required by solution rigid_rotation")
      if (dim == 1) call add_error(error, "&verification: solution rigid_rotation needs dimension 2 or 3")
      if (dim == 2 .and. any(is_set(options%angular_velocity(1:2)) .and. options%angular_velocity(1:2) /= 0.0_dp)) &
        call add_error(error, "&verification: angular_velocity turns the body out of the plane; one number is right in 2D")
    end select
    if (any(beyond(options%velocity, dim)) .or. any(beyond(options%center, dim)) .or. any(beyond(options%phases, dim))) &
      call add_error(error, "&verification: velocity, center and phases take "//text_of(dim)//" numbers here, one per dimension")
    do k = 1, size(given)
      if (given(k) .and. word_in(nth_word(option_words, k), reads) == 0) call add_error(error, "&verification: key " &
        //nth_word(option_words, k)//" is not read by solution "//nth_word(solution_words, solution)//"; it reads "//reads)
    end do
  end subroutine check_options

  !> Numbers given for axes that the scene has not (zero does no harm)
  pure function beyond(values, dim) result(is_beyond)
    real(dp), intent(in) :: values(3)
    integer, intent(in) :: dim
    logical :: is_beyond(3)
    is_beyond = is_set(values) .and. values /= 0.0_dp
    is_beyond(:dim) = .false.
  end function beyond

  !> Does the solution hold for this material?
  pure subroutine check_material(v, model, error)
    type(verification_t), intent(in) :: v
    character(len=*), intent(in) :: model
    type(error_t), allocatable, intent(inout) :: error
    logical :: wants_zero
    if (word_in(model, expected_models(v)) == 0) call add_error(error, "&verification: solution "//solution_name(v) &
      //" does not hold for model "//trim(model)//"; it holds for "//expected_models(v))
    wants_zero = v%solution == expanding_ring .or. v%solution == self_weight_column &
      .or. (v%solution == vibrating_bar .and. v%dim > 1)
    if (wants_zero .and. v%poisson /= 0.0_dp) call add_error(error, "&verification: solution "//solution_name(v) &
      //" needs poisson_ratio = 0, the material has "//text_of(v%poisson))
  end subroutine check_material

  !> The material models for which a solution is exact, words with blanks between
  pure function expected_models(v) result(words)
    type(verification_t), intent(in) :: v
    character(len=:), allocatable :: words
    select case (v%solution)
    case (axis_aligned, vortex, expanding_ring)
      words = "neo_hookean"
    case (self_weight_column, vibrating_bar)
      words = "neo_hookean hencky linear_elastic"
    case default
      words = "neo_hookean linear_elastic hencky hencky_von_mises drucker_prager"
    end select
  end function expected_models

  !> Law of a material model as far as the solutions tell them apart
  pure integer function law_of(model) result(law)
    character(len=*), intent(in) :: model
    select case (model)
    case ("neo_hookean")
      law = law_neo_hookean
    case ("hencky")
      law = law_hencky
    case ("linear_elastic")
      law = law_rate
    case default
      law = law_other
    end select
  end function law_of

  !> The word that names the solution
  pure function solution_name(v) result(word)
    type(verification_t), intent(in) :: v
    character(len=:), allocatable :: word
    word = nth_word(solution_words, v%solution)
  end function solution_name

  !> Displacement, velocity and deformation gradient in one go
  pure subroutine exact_motion(v, t, x, u, vel, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t !! time [s]
    real(dp), intent(in) :: x(lanes, 3) !! reference position X [m]; 0 in the components that the scene has not
    real(dp), intent(out) :: u(lanes, 3) !! displacement x - X [m]
    real(dp), intent(out) :: vel(lanes, 3) !! velocity [m/s]
    real(dp), intent(out) :: f(lanes, 9) !! deformation gradient, row by row
    select case (v%solution)
    case (vibrating_bar)
      call bar_motion(v, t, x, u, vel, f)
    case (axis_aligned)
      call axis_aligned_motion(v, t, x, u, vel, f)
    case (vortex)
      call vortex_motion(v, t, x, u, vel, f)
    case (expanding_ring)
      call ring_motion(v, t, x, u, vel, f)
    case (self_weight_column)
      call column_motion(v, x, u, vel, f)
    case (rigid_translation)
      call translation_motion(v, t, u, vel, f)
    case default
      call rotation_motion(v, t, x, u, vel, f)
    end select
  end subroutine exact_motion

  !> Displacement [m] of the points with reference position x at time t
  pure subroutine exact_displacement(v, t, x, u)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: u(lanes, 3)
    real(dp) :: vel(lanes, 3), f(lanes, 9)
    call exact_motion(v, t, x, u, vel, f)
  end subroutine exact_displacement

  !> Velocity [m/s] of the points with reference position x at time t
  pure subroutine exact_velocity(v, t, x, vel)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: vel(lanes, 3)
    real(dp) :: u(lanes, 3), f(lanes, 9)
    call exact_motion(v, t, x, u, vel, f)
  end subroutine exact_velocity

  !> Deformation gradient, row by row, of the points with reference position x at time t
  pure subroutine exact_deformation(v, t, x, f)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: f(lanes, 9)
    real(dp) :: u(lanes, 3), vel(lanes, 3)
    call exact_motion(v, t, x, u, vel, f)
  end subroutine exact_deformation

  !> Cauchy stress [Pa], tension positive, of the points with reference position x at time t.
  !>
  !> From F by the neo-Hookean law; bar: (lambda tr e I + 2 mu e) of the small strain; column: the weight above the point over
  !> the undeformed area, which nu = 0 keeps; rigid motions: none.
  pure subroutine exact_stress(v, t, x, sigma)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: sigma(lanes, 6)
    real(dp) :: u(lanes, 3), vel(lanes, 3), f(lanes, 9)
    integer :: p
    sigma = 0.0_dp
    select case (v%solution)
    case (axis_aligned, vortex, expanding_ring)
      call exact_motion(v, t, x, u, vel, f)
      do p = 1, lanes
        sigma(p, :) = neo_hookean_stress(v, f(p, :))
      end do
    case (vibrating_bar)
      call exact_motion(v, t, x, u, vel, f)
      sigma(:, 1) = (v%lambda + 2.0_dp*v%mu)*(f(:, 1) - 1.0_dp)
      sigma(:, 2) = v%lambda*(f(:, 1) - 1.0_dp)
      sigma(:, 3) = sigma(:, 2)
    case (self_weight_column)
      sigma(:, v%dim) = -v%density*v%gravity*max(v%length - (x(:, v%dim) - v%center(v%dim)), 0.0_dp)
    end select
  end subroutine exact_stress

  !> sigma = [lambda ln J I + mu (F F^T - I)]/J
  pure function neo_hookean_stress(v, f) result(sigma)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: f(9)
    real(dp) :: sigma(6), j, pressure_like
    j = f(1)*(f(5)*f(9) - f(6)*f(8)) - f(2)*(f(4)*f(9) - f(6)*f(7)) + f(3)*(f(4)*f(8) - f(5)*f(7))
    pressure_like = v%lambda*log(j) - v%mu
    sigma(1) = (pressure_like + v%mu*(f(1)**2 + f(2)**2 + f(3)**2))/j
    sigma(2) = (pressure_like + v%mu*(f(4)**2 + f(5)**2 + f(6)**2))/j
    sigma(3) = (pressure_like + v%mu*(f(7)**2 + f(8)**2 + f(9)**2))/j
    sigma(4) = v%mu*(f(1)*f(4) + f(2)*f(5) + f(3)*f(6))/j
    sigma(5) = v%mu*(f(4)*f(7) + f(5)*f(8) + f(6)*f(9))/j
    sigma(6) = v%mu*(f(7)*f(1) + f(8)*f(2) + f(9)*f(3))/j
  end function neo_hookean_stress

  !> Body force per mass [m/s2] that the solution needs, at the reference position x and time t; 0 where it needs none
  pure subroutine body_force(v, t, x, b)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: t, x(lanes, 3)
    real(dp), intent(out) :: b(lanes, 3)
    select case (v%solution)
    case (axis_aligned)
      call axis_aligned_force(v, t, x, b)
    case (vortex)
      call vortex_force(v, t, x, b)
    case (expanding_ring)
      call ring_force(v, t, x, b)
    case default
      b = 0.0_dp
    end select
  end subroutine body_force

  !> Must the body force be applied for the solution to hold? (The gravity of the column is the scene's own load.)
  pure logical function has_body_force(v)
    type(verification_t), intent(in) :: v
    has_body_force = v%solution == axis_aligned .or. v%solution == vortex .or. v%solution == expanding_ring
  end function has_body_force

  !> Is there a solution for a point with this reference position? Faces count to round-off.
  pure logical function is_defined_at(v, x)
    type(verification_t), intent(in) :: v
    real(dp), intent(in) :: x(3) !! reference position [m]
    real(dp) :: d(3), slack
    slack = 1.0e-9_dp
    d = x - v%center
    select case (v%solution)
    case (vibrating_bar)
      is_defined_at = d(1) >= -slack*v%length .and. d(1) <= (1.0_dp + slack)*v%length
    case (axis_aligned)
      is_defined_at = all(d(:v%dim) >= -slack) .and. all(d(:v%dim) <= 1.0_dp + slack)
    case (vortex, expanding_ring)
      is_defined_at = norm2(d(1:2)) >= (1.0_dp - slack)*v%inner_radius &
        .and. norm2(d(1:2)) <= (1.0_dp + slack)*v%outer_radius
    case (self_weight_column)
      is_defined_at = d(v%dim) >= -slack*v%length .and. d(v%dim) <= (1.0_dp + slack)*v%length
    case default
      is_defined_at = .true.
    end select
  end function is_defined_at

  !> Length by which errors of position are divided [m]
  pure real(dp) function error_scale(v)
    type(verification_t), intent(in) :: v
    select case (v%solution)
    case (vibrating_bar, axis_aligned, expanding_ring)
      error_scale = v%amplitude
    case (self_weight_column)
      error_scale = v%length
    case default
      error_scale = 1.0_dp
    end select
  end function error_scale

  !> What `error_scale` is, in words
  pure function error_scale_text(v) result(text)
    type(verification_t), intent(in) :: v
    character(len=:), allocatable :: text
    select case (v%solution)
    case (vibrating_bar)
      text = "v0/omega = "//text_of(v%amplitude)//" m"
    case (axis_aligned, expanding_ring)
      text = "amplitude = "//text_of(v%amplitude)//" m"
    case (self_weight_column)
      text = "length = "//text_of(v%length)//" m"
    case default
      text = "1 m (absolute)"
    end select
  end function error_scale_text

end module gimp_verification
