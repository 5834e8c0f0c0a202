!> Domains of cpGIMP follow the stretch and not the rotation, in two and three dimensions
program test_domains
  use gimp_kinds, only: wp, lanes, pi
  use gimp_domains, only: domain_half_lengths, domain_of_word, domain_stretch, domain_diagonal, domain_volume
  use gimp_basis, only: longest_half
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)
  integer :: seed = 2024

  call begin_suite("domains")
  call test_words()
  call test_rotation()
  call test_known_stretch(2)
  call test_known_stretch(3)
  call test_great_ratios()
  call test_one_dimension()
  call test_diagonal_and_volume()
  call test_clamps()
  call test_lanes()
  call end_suite()

contains

  !> Reproducible numbers in (-1, 1)
  real(wp) function random_real()
    seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
    random_real = 2*(seed/2147483647.0_wp) - 1
  end function random_real

  !> Rotation about z (2D) or about a random axis (Rodrigues)
  function rotation(dim, angle) result(q)
    integer, intent(in) :: dim
    real(wp), intent(in) :: angle
    real(wp) :: q(3, 3), n(3), w(3, 3)
    integer :: i
    n = [0.0_wp, 0.0_wp, 1.0_wp]
    if (dim == 3) n = [random_real(), random_real(), random_real()]
    n = n/norm2(n)
    w = reshape([0.0_wp, n(3), -n(2), -n(3), 0.0_wp, n(1), n(2), -n(1), 0.0_wp], [3, 3])
    q = sin(angle)*w + (1 - cos(angle))*matmul(w, w)
    do i = 1, 3
      q(i, i) = q(i, i) + 1
    end do
  end function rotation

  pure function diagonal(a) result(matrix)
    real(wp), intent(in) :: a(3)
    real(wp) :: matrix(3, 3)
    integer :: i
    matrix = 0
    do i = 1, 3
      matrix(i, i) = a(i)
    end do
  end function diagonal

  pure function flat(matrix) result(values)
    real(wp), intent(in) :: matrix(3, 3)
    real(wp) :: values(9)
    values = reshape(transpose(matrix), [9])
  end function flat

  subroutine test_words()
    call check(domain_of_word("stretch"), domain_stretch, "word stretch")
    call check(domain_of_word("diagonal"), domain_diagonal, "word diagonal")
    call check(domain_of_word("volume"), domain_volume, "word volume")
    call check(domain_of_word("corner"), 0, "an unknown word")
  end subroutine test_words

  !> A rotation by any angle, 90 and 180 degrees too, leaves the domain as it is
  subroutine test_rotation()
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3), worst
    integer :: dim, k, l, clamped
    do dim = 2, 3
      worst = 0.0_wp
      clamped = 0
      do k = 0, 7
        do l = 1, lanes
          f(l, :) = flat(rotation(dim, pi*(8*k + l - 1)/32.0_wp))
          half0(l, :) = [0.25_wp, 0.3_wp, 0.1_wp]
        end do
        call domain_half_lengths(domain_stretch, dim, f, half0, half, clamped)
        worst = max(worst, maxval(abs(half(:, :dim) - half0(:, :dim))))
      end do
      call check(worst, 0.0_wp, 10*round_off, "a rotation keeps the domain, dimension "//text_of(dim))
      call check(clamped, 0, "and clamps nothing")
    end do
  end subroutine test_rotation

  !> F = R U with U = Q diag(s) Q^T known by construction, stretches from 0.2 to 5; 1D and 2D formulas are closed, the
  !> iteration of 3D ends at round-off: 1e-13 of the largest stretch
  subroutine test_known_stretch(dim)
    integer, intent(in) :: dim
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3), u(3, 3, lanes), q(3, 3), s(3), worst
    integer :: trial, k, l, clamped
    worst = 0.0_wp
    half0 = 0.1_wp
    do trial = 1, 200
      do l = 1, lanes
        s = [(5.0_wp**random_real(), k=1, 3)]
        if (dim == 2) s(3) = 1
        q = rotation(dim, pi*random_real())
        u(:, :, l) = matmul(q, matmul(diagonal(s), transpose(q)))
        f(l, :) = flat(matmul(rotation(dim, pi*random_real()), u(:, :, l)))
      end do
      call domain_half_lengths(domain_stretch, dim, f, half0, half, clamped)
      do l = 1, lanes
        do k = 1, dim
          worst = max(worst, abs(half(l, k) - 0.1_wp*u(k, k, l)))
        end do
      end do
    end do
    call check(worst, 0.0_wp, 1.0e-13_wp, "half lengths are l0 U_kk, dimension "//text_of(dim))
  end subroutine test_known_stretch

  !> One stretch 60 times the others (and one 60 times less): U_kk is a sum of numbers as large as the largest stretch, so a
  !> short one is good to 60 roundings of it
  subroutine test_great_ratios()
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3), u(3, 3, lanes), q(3, 3), worst(2)
    integer :: trial, k, l, clamped, kind
    half0 = 0.01_wp
    worst = 0.0_wp
    do kind = 1, 2
      do trial = 1, 100
        do l = 1, lanes
          q = rotation(3, pi*random_real())
          if (trial == 1) q = diagonal([1.0_wp, 1.0_wp, 1.0_wp])
          u(:, :, l) = matmul(q, matmul(diagonal(merge([60.0_wp, 1.0_wp, 1.0_wp], [60.0_wp, 60.0_wp, 1.0_wp], kind == 1)), &
                                        transpose(q)))
          f(l, :) = flat(matmul(rotation(3, pi*random_real()), u(:, :, l)))
        end do
        clamped = 0
        call domain_half_lengths(domain_stretch, 3, f, half0, half, clamped)
        do l = 1, lanes
          do k = 1, 3
            worst(kind) = max(worst(kind), abs(half(l, k)/(0.01_wp*u(k, k, l)) - 1.0_wp))
          end do
        end do
      end do
    end do
    call check(worst(1), 0.0_wp, 1.0e-11_wp, "stretch ratio 60, one long axis")
    call check(worst(2), 0.0_wp, 1.0e-12_wp, "stretch ratio 60, one short axis")
  end subroutine test_great_ratios

  subroutine test_one_dimension()
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3)
    integer :: l, clamped
    f = 0.0_wp
    f(:, [1, 5, 9]) = 1.0_wp
    f(:, 1) = [(0.25_wp*l, l=1, lanes)]
    half0 = 0.25_wp
    clamped = 0
    call domain_half_lengths(domain_stretch, 1, f, half0, half, clamped)
    call check(half(:, 1), 0.25_wp*f(:, 1), 2*round_off, "in one dimension the stretch is F itself")
  end subroutine test_one_dimension

  !> l0 F_kk and l0 J^(1/d), by hand
  subroutine test_diagonal_and_volume()
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3)
    integer :: clamped
    f = spread([1.5_wp, 0.3_wp, 0.1_wp, -0.2_wp, 0.8_wp, 0.0_wp, 0.4_wp, 0.2_wp, 1.2_wp], 1, lanes)
    half0 = 0.25_wp
    clamped = 0
    call domain_half_lengths(domain_diagonal, 3, f, half0, half, clamped)
    call check(half(3, :), [0.375_wp, 0.2_wp, 0.3_wp], 2*round_off, "diagonal rule")
    call domain_half_lengths(domain_volume, 3, f, half0, half, clamped)
    ! det = 1.5(.96) - .3(-.24) + .1(-.04 - .32) = 1.44 + .072 - .036
    call check(half(3, :), spread(0.25_wp*1.476_wp**(1.0_wp/3.0_wp), 1, 3), 4*round_off, "volume rule in space")
    f = spread([1.5_wp, 0.3_wp, 0.0_wp, -0.2_wp, 0.8_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], 1, lanes)
    call domain_half_lengths(domain_volume, 2, f, half0, half, clamped)
    call check(half(8, :2), spread(0.25_wp*sqrt(1.26_wp), 1, 2), 4*round_off, "volume rule in the plane")
    call check(clamped, 0, "nothing was clamped")
  end subroutine test_diagonal_and_volume

  !> Never longer than two cells (and counted), never shorter than a thousandth; a negative F_kk makes no negative length
  subroutine test_clamps()
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3)
    integer :: clamped
    f = 0.0_wp
    f(:, [1, 5, 9]) = 1.0_wp
    f(2, 1) = 20.0_wp
    f(3, 5) = 30.0_wp
    f(5, 1) = 1.0e-5_wp
    f(7, 1) = -1.0_wp
    half0 = 0.25_wp
    clamped = 3
    call domain_half_lengths(domain_diagonal, 2, f, half0, half, clamped)
    call check(clamped, 5, "two more domains were shortened")
    call check(half(2, :2), [longest_half, 0.25_wp], 0.0_wp, "cut to the longest")
    call check(half(3, :2), [0.25_wp, longest_half], 0.0_wp, "cut along the other axis")
    call check(half(5, 1), 1.0e-3_wp, 0.0_wp, "never shorter than a thousandth of a cell")
    call check(half(7, 1), 1.0e-3_wp, 0.0_wp, "nor negative")
  end subroutine test_clamps

  !> Bit for bit the same in whatever company of other lanes
  subroutine test_lanes()
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3), alone(lanes, 3)
    integer :: dim, l, clamped
    do dim = 2, 3
      do l = 1, lanes
        f(l, :) = flat(matmul(rotation(dim, real(l, wp)), diagonal([1.0_wp + 0.3_wp*l, 1.0_wp/l, merge(2.0_wp, 1.0_wp, dim == 3)])))
      end do
      half0 = 0.1_wp
      call domain_half_lengths(domain_stretch, dim, f, half0, half, clamped)
      f = spread(f(4, :), 1, lanes)
      call domain_half_lengths(domain_stretch, dim, f, half0, alone, clamped)
      call check_true(all(alone == spread(half(4, :), 1, lanes)), "a lane does not depend on the others, dimension "//text_of(dim))
    end do
  end subroutine test_lanes

end program test_domains
