!> The models in the working precision, whichever it is: closed forms in double precision, yield surfaces after many steps,
!> and finite numbers where a particle is about to fail
program test_round_off
  use gimp_kinds, only: wp, dp, lanes
  use gimp_error, only: error_t
  use gimp_material, only: material_t
  use gimp_material_table, only: make_material, material_options_t
  use gimp_drucker_prager, only: drucker_prager_t
  use gimp_tensor, only: identity, multiply
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  character(len=16), parameter :: models(5) = [character(len=16) :: "neo_hookean", "hencky", "linear_elastic", &
    "hencky_von_mises", "drucker_prager"]
  integer, parameter :: room = 16 !! for the longest history
  !> Stresses are differences of numbers of size E: round-off is some epsilon E whatever the stress, strains here are of order 0.1
  real(wp), parameter :: young = 1000.0_wp, round_off = young*epsilon(1.0_wp)

  call begin_suite("round-off")
  call test_neo_hookean()
  call test_hencky()
  call test_yield_surfaces()
  call test_there_and_back()
  call test_finite()
  call end_suite()

contains

  !> E = 1000, nu = 0.25: lambda = mu = 400; strengths of a hundredth of it
  subroutine make(model, material, rate)
    character(len=*), intent(in) :: model
    character(len=*), intent(in), optional :: rate !! of linear_elastic
    class(material_t), allocatable, intent(out) :: material
    type(material_options_t) :: options
    type(error_t), allocatable :: error
    options%name = "sample"
    options%model = model
    options%density = 1000
    options%young_modulus = young
    options%poisson_ratio = 0.25_dp
    if (model == "hencky_von_mises") then
      options%yield_stress = 10
      options%hardening = "linear"
      options%hardening_modulus = 50
    else if (model == "drucker_prager") then
      options%cohesion = 10
      options%friction_angle = 30
    end if
    if (present(rate)) options%rate = rate
    call make_material(options, material, error)
    if (allocated(error)) error stop "the sample material is sound"
  end subroutine make

  !> Simple shear of 0.02 k in lane k on top of a stretch
  subroutine sheared(f)
    real(wp), intent(out) :: f(lanes, 9)
    integer :: k
    do k = 1, lanes
      f(k, :) = [1.1_wp, 0.02_wp*k, 0.0_wp, 0.0_wp, 0.95_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]
    end do
  end subroutine sheared

  !> tau = mu (b - I) + lambda ln J I
  subroutine test_neo_hookean()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, room), tau(lanes, 6), speed2(lanes)
    real(dp) :: expected(6), s
    integer :: k
    call make("neo_hookean", material)
    call sheared(f)
    state = 0
    call material%kirchhoff(f, state, tau, speed2)
    do k = 1, lanes
      s = real(f(k, 2), dp)
      expected(1:3) = 400*log(real(f(k, 1), dp)*f(k, 5)) &
        + 400*[real(f(k, 1), dp)**2 + s**2 - 1, real(f(k, 5), dp)**2 - 1, 0.0_dp]
      expected(4:6) = [400*s*f(k, 5), 0.0_dp, 0.0_dp]
      call check(tau(k, :), real(expected, wp), 4*round_off, "neo-Hookean stress")
    end do
  end subroutine test_neo_hookean

  !> tau_k = lambda sum ln F_kk + 2 mu ln F_kk for a stretch along the axes
  subroutine test_hencky()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, room), tau(lanes, 6), speed2(lanes)
    real(dp) :: e(3)
    integer :: k
    call make("hencky", material)
    f = 0
    do k = 1, lanes
      f(k, [1, 5, 9]) = [1 + 0.03_wp*k, 1 - 0.02_wp*k, 1.05_wp]
    end do
    state = 0
    call material%kirchhoff(f, state, tau, speed2)
    do k = 1, lanes
      e = log(real(f(k, [1, 5, 9]), dp))
      call check(tau(k, 1:3), real(400*sum(e) + 800*e, wp), 8*round_off, "Hencky stress of a stretch")
    end do
  end subroutine test_hencky

  !> After 500 steps of shear the stress lies on the surface: the last return puts it there, whatever was rounded before
  subroutine test_yield_surfaces()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), f_new(lanes, 9), df(lanes, 9), l(lanes, 9), state(lanes, room), tau(lanes, 6), work(lanes), ep(lanes)
    real(wp) :: stress(lanes, 6), p, root, worst
    integer :: model, step, k
    do model = 4, 5
      call make(trim(models(model)), material)
      f = spread(identity, 1, lanes)
      stress = 0
      state = 0
      call material%start_state(f, stress, state)
      l = 0
      do k = 1, lanes
        l(k, 2) = 1.0e-4_wp*k
        l(k, 5) = -1.0e-5_wp*k
      end do
      df = spread(identity, 1, lanes) + l
      do step = 1, 500
        call multiply(df, f, f_new)
        f = f_new
        call material%advance_state(1.0_wp, l, df, f, state, work)
      end do
      call material%kirchhoff(f, state, tau, work)
      call material%equivalent_plastic_strain(state, ep)
      call check_true(all(ep > 0.0_wp), trim(models(model))//": has flowed")
      worst = 0
      do k = 1, lanes
        p = sum(tau(k, 1:3))/3
        root = sqrt(0.5_wp*sum((tau(k, 1:3) - p)**2) + sum(tau(k, 4:6)**2))
        select type (material)
        type is (drucker_prager_t)
          worst = max(worst, abs(root + material%eta*p - material%strength))
        class default
          worst = max(worst, abs(sqrt(3.0_wp)*root - 10 - 50*ep(k)))
        end select
      end do
      call check(worst, 0.0_wp, 20*round_off, trim(models(model))//": on its surface after 500 steps")
    end do
  end subroutine test_yield_surfaces

  !> 300 steps out and 300 back: what stays is the round-off of 600 steps, each at most epsilon of E (rounding adds up as a
  !> random walk, so this is generous)
  subroutine test_there_and_back()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), df(lanes, 9), l(lanes, 9), state(lanes, room), tau(lanes, 6), speed2(lanes), stress(lanes, 6)
    integer :: step, k
    call make("linear_elastic", material)
    f = spread(identity, 1, lanes)
    stress = 0
    state = 0
    call material%start_state(f, stress, state)
    do step = 1, 600
      l = 0
      do k = 1, lanes
        l(k, 1) = merge(1.0_wp, -1.0_wp, step <= 300)*1.0e-4_wp*k
      end do
      df = spread(identity, 1, lanes) + l
      call material%advance_state(1.0_wp, l, df, f, state, speed2)
    end do
    call material%kirchhoff(f, state, tau, speed2)
    ! midpoint rates are not quite reversible: l/(1 + l/2) out, l/(1 - l/2) back leave l^2 a step
    call check(maxval(abs(tau)), 0.0_wp, 600*round_off + 301*1200*(1.0e-4_wp*lanes)**2, "linear elastic: there and back")
  end subroutine test_there_and_back

  !> Flat and inverted particles, and strains near the range of exp in single precision
  subroutine test_finite()
    character(len=16), parameter :: rates(4) = [character(len=16) :: "jaumann", "green_naghdi", "truesdell", "logarithmic"]
    class(material_t), allocatable :: material
    integer :: n
    do n = 1, size(models)
      call make(trim(models(n)), material)
      call stays_finite(material, trim(models(n)))
    end do
    do n = 1, size(rates)
      call make("linear_elastic", material, trim(rates(n)))
      call stays_finite(material, trim(rates(n)))
    end do
  end subroutine test_finite

  subroutine stays_finite(material, what)
    class(material_t), intent(in) :: material
    character(len=*), intent(in) :: what
    real(wp) :: f(lanes, 9), df(lanes, 9), l(lanes, 9), state(lanes, room), tau(lanes, 6), x(lanes), stress(lanes, 6)
    integer :: k
    stress = 0
    f = spread(identity, 1, lanes)
    state = 0
    call material%start_state(f, stress, state)
    do k = 1, lanes
      df(k, :) = identity*[-1, 0, 0, 0, 1, 0, 0, 0, 1]
      if (k > 2) df(k, :) = identity*[0, 0, 0, 0, 1, 0, 0, 0, 1]
      if (k > 4) df(k, :) = 0
      if (k > 6) df(k, :) = identity*1.0e5_wp
    end do
    l = df - f
    call material%advance_state(1.0_wp, l, df, df, state, x)
    call check_true(all(abs(state) <= huge(1.0_wp)), what//": history stays finite")
    call material%kirchhoff(df, state, tau, x)
    call check_true(all(abs(tau) <= huge(1.0_wp)) .and. all(abs(x) <= huge(1.0_wp)), what//": stress too")
    call material%stored_energy(df, state, x)
    call check_true(all(abs(x) <= huge(1.0_wp)), what//": energy too")
  end subroutine stays_finite

end program test_round_off
