!> Bodies from the elements of a mesh: whole contents, one owner for each piece, an order that does not depend on how elements are numbered
program test_element_region
  use gimp_kinds, only: wp, dp, i8
  use gimp_error, only: error_t
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_made_meshes, only: made_lines, made_triangles, made_quads, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic
  use gimp_mesh, only: mesh_t
  use gimp_mesh_connect, only: connect_mesh
  use gimp_mesh_renumber, only: renumber_mesh
  use gimp_search, only: locator_t, make_locator
  use gimp_shapes, only: shape_box, shape_region
  use gimp_fill, only: fill_body_t, fill_t, fill_bodies
  use gimp_element_region, only: element_region_t, make_element_region
  implicit none(type, external)
  real(dp), parameter :: lower(3) = [10.0_dp, -3.0_dp, 0.5_dp], spacing = 0.25_dp

  call begin_suite("element region")
  call whole("lines", made_lines(7, 0.3_dp), 2, 14)
  call whole("triangles", made_triangles([4, 3], 0.3_dp), 2, 96)
  call whole("quads", made_quads([4, 3], 0.3_dp), 3, 108)
  call whole("quads in triangles", made_quads([4, 3], 0.3_dp), 2, 96, simplices=.true.)
  call whole("hybrid in triangles", made_hybrid([4, 3], 0.2_dp), 1, 24, simplices=.true.)
  call whole("tetrahedra", made_tetrahedra([2, 2, 2], 0.2_dp), 2, 384)
  call whole("hexahedra", made_hexahedra([3, 2, 2], 0.2_dp), 2, 96)
  call whole("hexahedra in tetrahedra", made_hexahedra([2, 2, 2]), 1, 48, simplices=.true.)
  call whole("quadratic triangles", made_quadratic(made_triangles([3, 3], 0.2_dp), .false.), 2, 72)
  call whole("quadratic quads", made_quadratic(made_quads([3, 3], 0.2_dp), .true.), 2, 36)
  call groups_and_rivals()
  call end_suite()

contains

  !> The box of the mesh is filled whole, piece by piece the same whatever the numbers of nodes and elements
  subroutine whole(what, made, parts, particles, simplices)
    character(len=*), intent(in) :: what
    type(mesh_t), intent(in) :: made
    integer, intent(in) :: parts, particles
    logical, intent(in), optional :: simplices
    type(mesh_t), target :: mesh, other
    type(locator_t), target :: locator, other_locator
    type(element_region_t) :: region, again
    real(dp) :: low(3), high(3), content(2), centroid(made%dim, 2), moment(made%dim), box(made%dim), corner(made%dim, 2**made%dim), total
    integer(i8) :: k
    integer :: corners, i, outside, empty, differ
    logical :: cut
    cut = .false.
    if (present(simplices)) cut = simplices
    mesh = made
    call connect_mesh(mesh)
    call make_locator(mesh, locator)
    call make_element_region(mesh, locator, lower, spacing, 0, parts, cut, region, low, high)
    other = made
    call renumber_mesh(other, [(i, i=made%elements, 1, -1)], [(i, i=made%nodes, 1, -1)])
    call connect_mesh(other)
    call make_locator(other, other_locator)
    call make_element_region(other, other_locator, lower, spacing, 0, parts, cut, again, low, high)
    total = 0.0_dp
    moment = 0.0_dp
    outside = 0
    empty = 0
    differ = 0
    do k = 1, region%pieces()
      call region%piece(k, corners, corner, content(1), centroid(:, 1))
      call again%piece(k, corners, corner, content(2), centroid(:, 2))
      if (.not. region%holds(centroid(:, 1))) outside = outside + 1
      if (.not. content(1) > 0.0_dp) empty = empty + 1
      if (any(abs(centroid(:, 1) - centroid(:, 2)) > 0.0_dp) .or. abs(content(1) - content(2)) > 0.0_dp) differ = differ + 1
      total = total + content(1)
      moment = moment + content(1)*(centroid(:, 1) - lower(:made%dim))
    end do
    box = spacing*maxval(real(made%x, dp), dim=2)
    call check(int(region%pieces()), particles, what//": particles")
    call check(outside, 0, what//": pieces outside")
    call check(empty, 0, what//": pieces without content")
    call check(differ, 0, what//": pieces that depend on the numbers of elements")
    call check(total, product(box), 1.0e-13_dp*product(box), what//": whole") ! round-off of some hundred pieces
    call check(moment/total, 0.5_dp*box, 1.0e-13_dp*maxval(abs(lower)), what//": centroid of the whole")
    call check(high(:made%dim) - low(:made%dim), box, 1.0e-14_dp*maxval(abs(lower)), what//": box around it")
  end subroutine whole

  !> A group of elements, a box that takes what the elements leave, and a hole through both
  subroutine groups_and_rivals()
    type(mesh_t), target :: mesh
    type(locator_t), target :: locator
    type(element_region_t), target :: region
    type(fill_body_t) :: bodies(3)
    type(fill_t) :: fill
    type(error_t), allocatable :: error
    integer :: e
    mesh = made_quads([4, 4])
    mesh%element_group = [(merge(1, 0, modulo(e - 1, 4) < 2), e=1, 16)] ! x below 2
    call connect_mesh(mesh)
    call make_locator(mesh, locator)
    call make_element_region(mesh, locator, [0.0_dp, 0.0_dp, 0.0_dp], 1.0_dp, 1, 2, .false., region, bodies(1)%shape%lower, bodies(1)%shape%upper)
    bodies(1)%shape%kind = shape_region
    bodies(1)%shape%region => region
    bodies(2)%shape%kind = shape_box ! its left half is taken
    bodies(2)%shape%lower = [1.0_dp, 0.0_dp, 0.0_dp]
    bodies(2)%shape%upper = [3.0_dp, 4.0_dp, 0.0_dp]
    bodies(3)%shape%kind = shape_box
    bodies(3)%shape%lower = [1.5_dp, 0.0_dp, 0.0_dp]
    bodies(3)%shape%upper = [2.5_dp, 1.0_dp, 0.0_dp]
    bodies(3)%subtract = .true.
    call fill_bodies(2, [0.0_dp, 0.0_dp, 0.0_dp], 1.0_dp, [4, 4, 1], bodies, fill, error)
    call check_true(.not. allocated(error), "a region among shapes")
    call check(int(fill%count(1)), 32 - 2, "elements of the group without the hole")
    call check(int(fill%count(2)), 16 - 2, "a box takes what elements leave")
    call check(maxval(abs(fill%half_length - 0.25_dp)), 0.0_dp, 1.0e-15_dp, "half lengths of quarters of squares")
    call check(bodies(1)%shape%upper(:2), [2.0_dp, 4.0_dp], 0.0_dp, "box around a group")
  end subroutine groups_and_rivals

end program test_element_region
