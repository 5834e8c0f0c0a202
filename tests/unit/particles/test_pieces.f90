!> Pieces of elements: as many as promised, all with a positive content, together the whole element, sides cut alike by neighbours
program test_pieces
  use gimp_kinds, only: dp
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_pieces, only: pieces_of, cut_piece, measure_piece
  implicit none(type, external)
  integer :: dim, n

  call begin_suite("pieces")
  do n = 1, 5
    do dim = 1, 3
      call whole_element(dim, .false., n, .false.)
      if (dim == 1) cycle
      call whole_element(dim, .false., n, .true.)
      call whole_element(dim, .true., n, .false.)
    end do
  end do
  call halves()
  call corners_on_sides()
  call hexahedron()
  call end_suite()

contains

  !> Contents and moments of the pieces add up to those of the element in its natural coordinates
  subroutine whole_element(dim, is_simplex, n, simplices)
    integer, intent(in) :: dim, n
    logical, intent(in) :: is_simplex, simplices
    character(len=:), allocatable :: what
    real(dp) :: xi(3, 8), content, centroid(dim), total, moment(dim), least
    integer :: k, corners
    what = "element"
    if (simplices) what = "element in simplices"
    if (is_simplex) what = "simplex"
    total = 0.0_dp
    moment = 0.0_dp
    least = 1.0_dp
    do k = 1, pieces_of(dim, is_simplex, n, simplices)
      call cut_piece(dim, is_simplex, n, simplices, k, corners, xi)
      call measure_piece(xi(:dim, :corners), content, centroid)
      least = min(least, content)
      total = total + content
      moment = moment + content*centroid
    end do
    call check_true(least > 0.0_dp, what//": all pieces have content")
    ! round-off of up to 750 pieces
    if (is_simplex) then
      call check(total, 1.0_dp/merge(2, 6, dim == 2), 1.0e-14_dp, what//": whole")
      call check(moment/total, spread(1.0_dp/(dim + 1), 1, dim), 1.0e-14_dp, what//": centroid")
      call check(least*n**dim, 1.0_dp/merge(2, 6, dim == 2), 1.0e-13_dp, what//": equal pieces")
    else
      call check(total, 2.0_dp**dim, 1.0e-13_dp, what//": whole")
      call check(moment/total, spread(0.0_dp, 1, dim), 1.0e-14_dp, what//": centroid")
    end if
  end subroutine whole_element

  !> The eight tetrahedra of a tetrahedron: one at each corner, four around the middle
  subroutine halves()
    real(dp) :: xi(3, 8), content, centroid(3)
    integer :: k, corners, at_corner
    at_corner = 0
    do k = 1, pieces_of(3, .true., 2, .false.)
      call cut_piece(3, .true., 2, .false., k, corners, xi)
      call measure_piece(xi(:, :corners), content, centroid)
      if (any(sum(abs(xi(:, :4)), dim=1) < 1.0e-12_dp) .or. any(abs(xi(:, :4) - 1.0_dp) < 1.0e-12_dp)) at_corner = at_corner + 1
    end do
    call check(at_corner, 4, "pieces at the corners of a tetrahedron")
  end subroutine halves

  !> The sides of a tetrahedron are all cut by lines along their edges, so that neighbours meet however their nodes are numbered: each piece
  !> with three corners on a side has an edge of the side's lattice between any two of them
  subroutine corners_on_sides()
    integer, parameter :: n = 3
    real(dp) :: xi(3, 8), lambda(4, 4), step(4)
    integer :: k, corners, side, a, b, on_side, found(4)
    logical :: along
    found = 0
    along = .true.
    do k = 1, pieces_of(3, .true., n, .false.)
      call cut_piece(3, .true., n, .false., k, corners, xi)
      lambda(2:, :) = xi(:, :4)
      lambda(1, :) = 1.0_dp - sum(xi(:, :4), dim=1)
      do side = 1, 4
        on_side = count(abs(lambda(side, :)) < 1.0e-12_dp)
        if (on_side < 3) cycle
        found(side) = found(side) + 1
        do a = 1, 4
          do b = 1, a - 1
            if (max(abs(lambda(side, a)), abs(lambda(side, b))) > 1.0e-12_dp) cycle
            step = abs(lambda(:, a) - lambda(:, b))*n
            along = along .and. count(step < 1.0e-12_dp) == 2 .and. count(abs(step - 1.0_dp) < 1.0e-12_dp) == 2
          end do
        end do
      end do
    end do
    call check_true(all(found == n*n), "triangles on the sides of a tetrahedron")
    call check_true(along, "cut along the edges")
  end subroutine corners_on_sides

  !> A twisted hexahedron against the sum over many small ones, whose twist vanishes
  subroutine hexahedron()
    real(dp) :: corner(3, 8), xi(3, 8), small(3, 8), content, centroid(3), total, part, at(3), moment(3)
    integer :: k, a, corners
    corner = reshape([0.0_dp, 0.0_dp, 0.1_dp, 1.1_dp, 0.0_dp, 0.0_dp, 0.0_dp, 0.9_dp, 0.0_dp, 1.0_dp, 1.2_dp, -0.1_dp, &
                      0.1_dp, 0.0_dp, 1.0_dp, 1.0_dp, -0.1_dp, 1.1_dp, 0.0_dp, 1.0_dp, 1.2_dp, 0.9_dp, 1.0_dp, 1.0_dp], [3, 8])
    call measure_piece(corner, content, centroid)
    total = 0.0_dp
    moment = 0.0_dp
    do k = 1, pieces_of(3, .false., 4, .false.)
      call cut_piece(3, .false., 4, .false., k, corners, xi)
      do a = 1, 8
        small(:, a) = place(corner, xi(:, a))
      end do
      call measure_piece(small, part, at)
      total = total + part
      moment = moment + part*at
    end do
    call check(total, content, 1.0e-14_dp, "hexahedron: content of its parts") ! trilinear in trilinear: exact but for round-off
    call check(moment/total, centroid, 1.0e-14_dp, "hexahedron: centroid of its parts")
  end subroutine hexahedron

  !> A point of a hexahedron from its natural coordinates
  pure function place(corner, xi) result(x)
    real(dp), intent(in) :: corner(3, 8), xi(3)
    real(dp) :: x(3)
    integer :: a, k
    x = 0.0_dp
    do a = 1, 8
      x = x + corner(:, a)*product([(0.5_dp*(1.0_dp + merge(xi(k), -xi(k), btest(a - 1, k - 1))), k=1, 3)])
    end do
  end function place

end program test_pieces
