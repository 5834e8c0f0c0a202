!> How elements are cut into the pieces that particles stand for, and how large pieces are.
!>
!> An edge is cut into n parts: lines into n, quadrilaterals and hexahedra into n^d cells, triangles and tetrahedra into n^d simplices: the
!> map x_1 >= x_2 (>= x_3) of lattice points to barycentric coordinates (0, x_1 - x_2, x_2 - x_3, x_3)/n takes the cells of a lattice, cut
!> along the diagonal as by Kuhn (1960), to the regular split. Neighbours that share a side cut it alike.
module gimp_pieces
  use gimp_kinds, only: dp
  implicit none(type, external)
  private
  public :: pieces_of, cut_piece, measure_piece, simplex_content, quadrilateral_area, quadrilateral_centroid
  public :: box_triangles, box_tetrahedra

  !> The simplices of a box with its corners numbered with the first axis fastest: one for each order of the axes
  integer, parameter :: box_triangles(3, 2) = reshape([1, 2, 4, 1, 4, 3], [3, 2])
  integer, parameter :: box_tetrahedra(4, 6) = reshape([1, 2, 4, 8, 1, 3, 7, 8, 1, 5, 6, 8, 1, 4, 3, 8, 1, 7, 5, 8, 1, 6, 2, 8], [4, 6])

contains

  !> Number of pieces of an element
  pure integer function pieces_of(dim, is_simplex, n, simplices) result(pieces)
    integer, intent(in) :: dim, n !! n: parts of an edge
    logical, intent(in) :: is_simplex !! the element is a triangle or a tetrahedron
    logical, intent(in) :: simplices !! all pieces are to be such
    pieces = n**dim
    if (simplices .and. .not. is_simplex) pieces = pieces*size(tables(dim), 2)
  end function pieces_of

  !> Natural coordinates of the corners of a piece: [-1, 1]^d of lines, quadrilaterals and hexahedra, barycentric coordinates of the nodes
  !> 2, 3 (, 4) of triangles and tetrahedra. The corners of cells are numbered with the first axis fastest
  pure subroutine cut_piece(dim, is_simplex, n, simplices, piece, corners, xi)
    integer, intent(in) :: dim, n
    logical, intent(in) :: is_simplex, simplices !! as of `pieces_of`
    integer, intent(in) :: piece !! from 1
    integer, intent(out) :: corners
    real(dp), intent(out) :: xi(3, 8)
    integer :: at(3, 8), cell(3), part, k
    xi = 0.0_dp
    if (is_simplex) then
      call find_part(dim, piece, cell, part)
      call place_simplex(dim, cell, part, at)
      corners = dim + 1
      xi(:dim - 1, :corners) = real(at(:dim - 1, :corners) - at(2:dim, :corners), dp)/n
      xi(dim, :corners) = real(at(dim, :corners), dp)/n
      return
    end if
    part = 1
    k = piece - 1
    if (simplices) then
      part = 1 + modulo(k, size(tables(dim), 2))
      k = k/size(tables(dim), 2)
    end if
    cell = [k/n**(dim - 1), modulo(k/n**max(dim - 2, 0), n), modulo(k, n)] ! the last axis fastest
    if (simplices .and. dim > 1) then
      corners = dim + 1
      call place_simplex(dim, cell, part, at)
    else
      corners = 2**dim
      do k = 1, corners
        at(:, k) = cell + offset(k)
      end do
    end if
    xi(:dim, :corners) = 2.0_dp*at(:dim, :corners)/n - 1.0_dp
  end subroutine cut_piece

  !> The simplices that a box is cut into; a line is one
  pure function tables(dim) result(table)
    integer, intent(in) :: dim
    integer, allocatable :: table(:, :) !! (dim + 1, simplices)
    select case (dim)
    case (1); table = reshape([1, 2], [2, 1])
    case (2); table = box_triangles
    case default; table = box_tetrahedra
    end select
  end function tables

  !> Corner of a cell, from its first one
  pure function offset(corner) result(step)
    integer, intent(in) :: corner
    integer :: step(3)
    integer :: k
    step = [(merge(1, 0, btest(corner - 1, k)), k=0, 2)]
  end function offset

  pure subroutine place_simplex(dim, cell, part, at)
    integer, intent(in) :: dim, cell(3), part
    integer, intent(out) :: at(3, 8)
    integer :: table(dim + 1, merge(1, merge(2, 6, dim == 2), dim == 1)), k
    at = 0
    table = tables(dim)
    do k = 1, dim + 1
      at(:, k) = cell + offset(table(k, part))
    end do
  end subroutine place_simplex

  !> The cell of the lattice x_1 >= x_2 (>= x_3) and the part of it that is a piece of a simplex; k^d pieces have x_1 below k
  pure subroutine find_part(dim, piece, cell, part)
    integer, intent(in) :: dim, piece
    integer, intent(out) :: cell(3), part
    integer :: left, at(3, 8), a, b, c
    a = 0
    do while ((a + 1)**dim < piece)
      a = a + 1
    end do
    left = piece - a**dim
    do b = 0, a
      do c = 0, merge(b, 0, dim > 2)
        cell = [a, b, c]
        do part = 1, size(tables(dim), 2)
          call place_simplex(dim, cell, part, at)
          if (any(at(:dim - 1, :dim + 1) < at(2:dim, :dim + 1))) cycle
          left = left - 1
          if (left == 0) return
        end do
      end do
    end do
  end subroutine find_part

  !> Content of a piece between its corners and its centroid
  pure subroutine measure_piece(corner, content, centroid)
    real(dp), intent(in) :: corner(:, :) !! (dim, corners) of a simplex, or of a cell with the first axis fastest
    real(dp), intent(out) :: content, centroid(:)
    integer :: d
    d = size(corner, 1)
    if (d == 1) then
      content = corner(1, 2) - corner(1, 1)
      centroid = 0.5_dp*(corner(:, 1) + corner(:, 2))
    else if (size(corner, 2) == d + 1) then
      content = simplex_content(corner)
      centroid = sum(corner, dim=2)/size(corner, 2)
    else if (d == 2) then
      content = quadrilateral_area(corner)
      centroid = quadrilateral_centroid(corner)
    else
      call measure_hexahedron(corner, content, centroid)
    end if
  end subroutine measure_piece

  !> Area of a triangle, volume of a tetrahedron
  pure real(dp) function simplex_content(corner) result(content)
    real(dp), intent(in) :: corner(:, :)
    real(dp) :: e(size(corner, 1), size(corner, 1))
    e = corner(:, 2:) - spread(corner(:, 1), 2, size(corner, 1))
    if (size(corner, 1) == 2) then
      content = 0.5_dp*(e(1, 1)*e(2, 2) - e(2, 1)*e(1, 2))
    else
      content = determinant(e)/6.0_dp
    end if
  end function simplex_content

  !> Corners with the first axis fastest
  pure real(dp) function quadrilateral_area(box) result(area)
    real(dp), intent(in) :: box(2, 4)
    area = simplex_content(box(:, [1, 2, 4])) + simplex_content(box(:, [1, 4, 3]))
  end function quadrilateral_area

  pure function quadrilateral_centroid(box) result(x)
    real(dp), intent(in) :: box(2, 4)
    real(dp) :: x(2)
    x = (simplex_content(box(:, [1, 2, 4]))*(box(:, 1) + box(:, 2) + box(:, 4)) &
         + simplex_content(box(:, [1, 4, 3]))*(box(:, 1) + box(:, 4) + box(:, 3)))/(3.0_dp*quadrilateral_area(box))
  end function quadrilateral_centroid

  !> Two Gauss points an axis are exact: x det J is cubic in each coordinate. About the first corner, so that a far origin costs no digits
  pure subroutine measure_hexahedron(corner, content, centroid)
    real(dp), intent(in) :: corner(3, 8)
    real(dp), intent(out) :: content, centroid(3)
    real(dp) :: from(3, 8), jacobian(3, 3), x(3), part(2, 3), share
    integer :: a, g, k, i
    from = corner - spread(corner(:, 1), 2, 8)
    content = 0.0_dp
    centroid = 0.0_dp
    do g = 1, 8
      do k = 1, 3
        part(2, k) = 0.5_dp*(1.0_dp + merge(1.0_dp, -1.0_dp, btest(g - 1, k - 1))/sqrt(3.0_dp)) ! how far along the axis
        part(1, k) = 1.0_dp - part(2, k)
      end do
      x = 0.0_dp
      jacobian = 0.0_dp
      do a = 1, 8
        associate (s => 1 + offset(a))
          x = x + part(s(1), 1)*part(s(2), 2)*part(s(3), 3)*from(:, a)
          do i = 1, 3
            k = modulo(i, 3) + 1
            share = part(s(k), k)*part(s(6 - i - k), 6 - i - k)
            jacobian(:, i) = jacobian(:, i) + merge(share, -share, s(i) == 2)*from(:, a)
          end do
        end associate
      end do
      content = content + determinant(jacobian)/8.0_dp
      centroid = centroid + determinant(jacobian)/8.0_dp*x
    end do
    centroid = corner(:, 1) + centroid/content
  end subroutine measure_hexahedron

  pure real(dp) function determinant(e)
    real(dp), intent(in) :: e(3, 3)
    determinant = e(1, 1)*(e(2, 2)*e(3, 3) - e(3, 2)*e(2, 3)) + e(2, 1)*(e(3, 2)*e(1, 3) - e(1, 2)*e(3, 3)) &
                  + e(3, 1)*(e(1, 2)*e(2, 3) - e(2, 2)*e(1, 3))
  end function determinant

end module gimp_pieces
