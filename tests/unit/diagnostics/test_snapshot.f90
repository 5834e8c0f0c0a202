!> Frames: fields in the order of numbers, gaps in the numbers closed
program test_snapshot
  use gimp_kinds, only: wp, i8, lanes
  use gimp_basis, only: basis_cpgimp
  use gimp_engine, only: engine_t
  use gimp_resort, only: sort_particles
  use gimp_verification, only: verification_t
  use gimp_snapshot, only: field_components, field_words, needs_reference, order_t, order_particles, sample_positions, sample_field
  use gimp_engine_fixture, only: cloud_t, random_cloud, make_engine
  use gimp_text, only: text_of, count_words, nth_word
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.25_wp
  integer, parameter :: n = 200, n_kept = 134 !! without every third
  integer :: seed = 3

  call begin_suite("snapshot")
  call test_names()
  call test_fields(2)
  call test_fields(3)
  call end_suite()

contains

  subroutine test_names()
    integer :: k
    do k = 1, count_words(field_words)
      call check_true(field_components(nth_word(field_words, k)) > 0, "field "//nth_word(field_words, k)//" has components")
    end do
    call check(field_components("temperature"), 0, "an unknown field has none")
    call check_true(needs_reference("displacement") .and. .not. needs_reference("stress"), "who needs the reference position")
  end subroutine test_names

  !> Every third particle is removed; the others appear in the order of their numbers with the values they were given
  subroutine test_fields(dim)
    integer, intent(in) :: dim
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    logical, allocatable :: remove(:, :)
    type(order_t) :: order
    integer :: kept(n_kept), i, q, c, l
    real(wp) :: values(9, n_kept), x(3, n_kept), j, tau(lanes, 6), speed2(lanes), f(lanes, 9), state(lanes, 1), high(3)
    real(wp) :: worst(9)
    high = 0.0_wp
    high(:dim) = 9.0_wp
    call random_cloud(dim, n, [0.0_wp, 0.0_wp, 0.0_wp], high, 0.1_wp, 0.5_wp, seed, cloud)
    cloud%material(::4) = 2
    call make_engine(dim, basis_cpgimp, merge([10, 10, 10], [1, 1, 1], [1, 2, 3] <= dim), spacing, cloud, engine)
    allocate (remove(lanes, engine%particles%chunks))
    do c = 1, engine%particles%chunks
      do l = 1, lanes
        remove(l, c) = modulo(engine%particles%id(l, c), 3_i8) == 0
      end do
    end do
    call sort_particles(engine, remove)
    kept = pack([(i, i=1, n)], modulo([(i, i=1, n)], 3) /= 0)
    call order_particles(engine, order)
    call sample_positions(engine, order%slot, x)
    call check(maxval(abs(x(:dim, :) - spacing*cloud%x(:dim, kept))), 0.0_wp, 1.0e-14_wp, "positions in metres")
    if (dim == 2) call check(maxval(abs(x(3, :))), 0.0_wp, 0.0_wp, "in the plane")
    worst = 0.0_wp
    call sample(engine, order%slot, "velocity", values)
    worst(1) = maxval(abs(values(:3, :) - cloud%v(:, kept)))
    call sample(engine, order%slot, "deformation_gradient", values)
    worst(2) = maxval(abs(values - cloud%f(:, kept)))
    call sample(engine, order%slot, "mass", values)
    worst(3) = maxval(abs(values(1, :) - cloud%mass(kept)))
    call sample(engine, order%slot, "id", values)
    worst(4) = maxval(abs(values(1, :) - kept))
    call sample(engine, order%slot, "material", values)
    worst(5) = maxval(abs(values(1, :) - cloud%material(kept)))
    call sample(engine, order%slot, "body", values)
    worst(6) = maxval(abs(values(1, :) - merge(2, 1, kept >= 100)))
    call sample(engine, order%slot, "half_length", values)
    worst(7) = maxval(abs(values(:dim, :) - spacing*cloud%half(:dim, kept)))
    call check(worst(:7), spread(0.0_wp, 1, 7), 1.0e-15_wp, "fields are those of the particles, in the order of numbers")
    call sample(engine, order%slot, "stress", values)
    state = 0.0_wp
    do q = 1, size(kept)
      i = kept(q)
      f = spread(cloud%f(:, i), 1, lanes)
      j = determinant(cloud%f(:, i))
      call engine%laws(cloud%material(i))%law%kirchhoff(f, state, tau, speed2)
      worst(8) = max(worst(8), maxval(abs(values(:6, q) - tau(1, :)/j)))
    end do
    call check(worst(8), 0.0_wp, 1.0e-11_wp, "stress is Cauchy's")
    call sample(engine, order%slot, "density", values)
    do q = 1, size(kept)
      i = kept(q)
      worst(9) = max(worst(9), abs(values(1, q)*determinant(cloud%f(:, i))*cloud%volume(i)/cloud%mass(i) - 1.0_wp))
    end do
    call check(worst(9), 0.0_wp, 1.0e-14_wp, "density is mass over present volume")
    call sample(engine, order%slot, "displacement", values)
    call check(maxval(abs(values(:3, :))), 0.0_wp, 1.0e-14_wp, "nothing has moved yet")

  end subroutine test_fields

  subroutine sample(engine, slot, name, values)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(in) :: slot(:, :)
    character(len=*), intent(in) :: name
    real(wp), intent(out) :: values(:, :)
    type(verification_t) :: none
    values = huge(1.0_wp)
    call sample_field(engine, name, slot, [1_i8, 100_i8], none, 0.0_wp, values(:field_components(name), :))
  end subroutine sample

  pure real(wp) function determinant(f)
    real(wp), intent(in) :: f(9)
    determinant = f(1)*(f(5)*f(9) - f(6)*f(8)) - f(2)*(f(4)*f(9) - f(6)*f(7)) + f(3)*(f(4)*f(8) - f(5)*f(7))
  end function determinant

end program test_snapshot
