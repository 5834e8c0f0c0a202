!> Mesh files come back as written; what is wrong with the file itself is told. (What is wrong with a mesh: test_mesh_checks)
program test_mesh_file
  use gimp_kinds, only: dp
  use gimp_error, only: error_t, report_lines
  use gimp_file_system, only: delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, write_dataset, write_attribute, create_group
  use gimp_mesh, only: mesh_t
  use gimp_mesh_file, only: read_mesh
  use gimp_made_meshes, only: made_lines, made_triangles, made_quads, made_hybrid, made_tetrahedra, made_hexahedra, made_quadratic, &
    write_made_mesh
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  character(len=*), parameter :: path = "test_mesh_file.h5"
  type(error_t), allocatable :: error

  call begin_suite("mesh files")
  call comes_back("lines", made_lines(7, 0.3_dp), 1.0_dp)
  call comes_back("triangles", made_triangles([5, 4], 0.3_dp), 1.0_dp)
  call comes_back("quads", made_quads([5, 4], 0.3_dp), 1.0_dp)
  call comes_back("tetrahedra", made_tetrahedra([3, 2, 4], 0.2_dp), 1.0_dp)
  call comes_back("hexahedra", made_hexahedra([3, 2, 4], 0.2_dp), 1.0_dp)
  call comes_back("quad9", made_quadratic(made_quads([4, 3], 0.2_dp), .true.), 1.0_dp)
  call comes_back("triangle6 and quad8", made_quadratic(made_hybrid([6, 4], 0.2_dp), .false., 0.1_dp), 0.0_dp)
  call groups_come_back()
  call wrong_files()
  call delete_file(path, error)
  call end_suite()

contains

  !> A mesh in a place and a size of its own, and the length that the reader takes for a cell
  subroutine comes_back(name, mesh, cell)
    character(len=*), intent(in) :: name
    type(mesh_t), intent(in) :: mesh
    real(dp), intent(in) :: cell !! expected [cells as made]; 0: not known
    type(mesh_t) :: back
    real(dp) :: lower(3), spacing
    real(dp), parameter :: corner(3) = [3.0_dp, -2.0_dp, 0.5_dp], size_in_metres = 0.05_dp
    call write_made_mesh(path, mesh, corner, size_in_metres)
    spacing = size_in_metres
    call read_mesh(path, mesh%dim, lower, spacing, back, error)
    if (allocated(error)) then
      call check_true(.false., name//" read: "//error%message)
      return
    end if
    call check(spacing, size_in_metres, 0.0_dp, name//": spacing given stays")
    call check(maxval(abs(back%x - mesh%x + spread((lower(:mesh%dim) - corner(:mesh%dim))/size_in_metres, 2, mesh%nodes))), 0.0_dp, &
      1.0e-13_dp, name//": places") ! lower/spacing = 60, rounded
    call check_true(all(back%kind == mesh%kind) .and. all(back%node == mesh%node), name//": elements")
    call check_true(all(back%element_in_file == mesh%element_in_file) .and. all(back%node_in_file == mesh%node_in_file), name//": numbers")
    call check_true(all(back%side_group_name == mesh%side_group_name) .and. all(back%named_side_node == mesh%named_side_node) &
      .and. all(back%named_side_group == mesh%named_side_group), name//": named sides")
    call check(count(back%side_group > 0), size(mesh%named_side_group), name//": connected")
    spacing = 0.0_dp
    call read_mesh(path, mesh%dim, lower, spacing, back, error)
    call check(minval(back%x), 0.0_dp, 0.0_dp, name//": corner of the box")
    if (cell > 0.0_dp) call check(spacing, cell*size_in_metres, 1.0e-14_dp, name//": edge of a mean element") ! sum of 150 volumes, rounded
    if (cell > 0.0_dp) call check(lower(:mesh%dim), corner(:mesh%dim), 0.0_dp, name//": place of the box")
  end subroutine comes_back

  subroutine groups_come_back()
    type(mesh_t) :: mesh, back
    real(dp) :: lower(3), spacing
    integer :: e
    mesh = made_hybrid([5, 4])
    mesh%element_group_name = [character(len=32) :: "sand", "wet clay, firm", repeat("n", 32)]
    mesh%element_group = [(modulo(e, 4), e=1, mesh%elements)]
    call write_made_mesh(path, mesh, [0.0_dp, 0.0_dp], 1.0_dp)
    spacing = 0.0_dp
    call read_mesh(path, 2, lower, spacing, back, error)
    call check_true(.not. allocated(error), "groups: read")
    call check_true(all(back%element_group == mesh%element_group), "groups of elements")
    call check_true(all(back%element_group_name == mesh%element_group_name), "names of groups")
  end subroutine groups_come_back

  !> Files that are no mesh files, or other ones than the scene needs
  subroutine wrong_files()
    integer :: unit
    call expect("not_there.h5", 2, "no such file")
    open (newunit=unit, file=path, status="replace")
    write (unit, *) "no mesh"
    close (unit)
    call expect(path, 2, "not an HDF5 file")
    call write_quads()
    call change("format", "gimp-particles")
    call expect(path, 2, "is not a mesh file")
    call write_quads()
    call change_number("version", 2)
    call expect(path, 2, "version 2")
    call write_quads()
    call expect(path, 3, "2 dimensions; the scene has 3")
    call write_quads()
    call add_table("elements/line2", 2)
    call expect(path, 2, "elements/line2 in a mesh of dimension 2")
    call write_quads()
    call add_table("elements/wedge6", 6)
    call expect(path, 2, "wedge6 is no kind of element known here; in 2 dimensions there are: triangle3 triangle6 quad4 quad8 quad9")
    call write_quads()
    call add_table("elements/triangle3", 4)
    call expect(path, 2, "elements/triangle3 has 4 columns; must have 3")
    call write_quads()
    call add_vector("elements/triangle3_group", 3)
    call expect(path, 2, "triangle3_group belongs to elements that are not there")
    call write_quads()
    call add_vector("elements/quad4_group", 3)
    call expect(path, 2, "quad4_group has 3 values for 6 elements")
    call write_quads()
    call change("side_groups", "low"//new_line("a")//"high"//new_line("a")//"low")
    call expect(path, 2, "'low' is there twice")
    call write_quads()
    call change("side_groups", "x_low"//new_line("a")//new_line("a")//"y_low"//new_line("a")//"y_high")
    call expect(path, 2, "'' is no name of a group")
    call write_quads()
    call change("element_groups", repeat("x", 33))
    call expect(path, 2, "is no name of a group; it has 1 to 32 letters")
    call write_header(2)
    call expect(path, 2, "no dataset nodes")
    call write_header(2)
    call add_vector("nodes", 3)
    call expect(path, 2, "nodes has 1 dimensions; must be (rows, 2)")
    call write_header(2)
    call add_table("nodes", 3)
    call expect(path, 2, "nodes has 3 columns; must have 2")
    call write_header(2)
    call add_table("nodes", 2)
    call expect(path, 2, "holds no elements of dimension 2")
    call add_table("elements/line2", 2)
    call add_table("elements/triangle3", 2)
    call expect(path, 2, "elements/line2 in a mesh", mistakes=2)
    call expect(path, 2, "elements/triangle3 has 2 columns", mistakes=2)
  end subroutine wrong_files

  subroutine write_quads()
    call write_made_mesh(path, made_quads([3, 2]), [0.0_dp, 0.0_dp], 1.0_dp)
  end subroutine write_quads

  !> A file without tables
  subroutine write_header(dim)
    integer, intent(in) :: dim
    type(hdf5_file_t) :: file
    call open_hdf5(path, "overwrite", file, error)
    call write_attribute(file, "", "format", "gimp-mesh", error)
    call write_attribute(file, "", "version", 1, error)
    call write_attribute(file, "", "dimension", dim, error)
    call create_group(file, "elements", error)
    call close_hdf5(file, error)
  end subroutine write_header

  subroutine change(attribute, text)
    character(len=*), intent(in) :: attribute, text
    type(hdf5_file_t) :: file
    call open_hdf5(path, "append", file, error)
    call write_attribute(file, "", attribute, text, error)
    call close_hdf5(file, error)
  end subroutine change

  subroutine change_number(attribute, number)
    character(len=*), intent(in) :: attribute
    integer, intent(in) :: number
    type(hdf5_file_t) :: file
    call open_hdf5(path, "append", file, error)
    call write_attribute(file, "", attribute, number, error)
    call close_hdf5(file, error)
  end subroutine change_number

  !> Two rows
  subroutine add_table(name, columns)
    character(len=*), intent(in) :: name
    integer, intent(in) :: columns
    type(hdf5_file_t) :: file
    integer :: k
    call open_hdf5(path, "append", file, error)
    call write_dataset(file, name, reshape([(k, k=1, 2*columns)], [columns, 2]), error)
    call close_hdf5(file, error)
  end subroutine add_table

  subroutine add_vector(name, n)
    character(len=*), intent(in) :: name
    integer, intent(in) :: n
    type(hdf5_file_t) :: file
    integer :: k
    call open_hdf5(path, "append", file, error)
    call write_dataset(file, name, [(k, k=1, n)], error)
    call close_hdf5(file, error)
  end subroutine add_vector

  !> Reading fails with this message
  subroutine expect(name, dim, part, mistakes)
    character(len=*), intent(in) :: name, part
    integer, intent(in) :: dim
    integer, intent(in), optional :: mistakes !! 1 if absent
    type(mesh_t) :: mesh
    real(dp) :: lower(3), spacing
    integer :: n
    n = 1
    if (present(mistakes)) n = mistakes
    spacing = 0.0_dp
    call read_mesh(name, dim, lower, spacing, mesh, error)
    call check_true(allocated(error), part//": refused")
    if (.not. allocated(error)) return
    call check_true(index(error%message, part) > 0, part//": told as '"//error%message//"'")
    call check_true(index(error%message, name//": ") == 1, part//": the file is named")
    call check(report_lines(error), n, part//": mistakes told in '"//error%message//"'")
  end subroutine expect

end program test_mesh_file
