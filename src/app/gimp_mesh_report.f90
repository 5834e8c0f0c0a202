!> What a run says about its unstructured mesh: size, sides and their conditions, and how particles were searched for
module gimp_mesh_report
  use gimp_kinds, only: wp, dp, i8
  use gimp_error, only: error_t
  use gimp_text, only: text_of, with_thousands, short_number
  use gimp_grid, only: fields_per_node
  use gimp_mesh, only: mesh_t, n_kinds, kind_name
  use gimp_engine, only: engine_t, least_spacing, sum_visits, sum_left, sum_by_velocity, sum_by_walk, sum_by_rings, sum_put_back, sum_beyond
  use gimp_walls, only: walls_t, side_free, side_stick, side_slip, side_symmetry, side_velocity
  use gimp_summary, only: put_summary
  use gimp_output_file, only: output_file_t
  use gimp_books, only: books_t
  use gimp_mesh_content, only: mesh_hash
  use, intrinsic :: iso_fortran_env, only: output_unit
  implicit none(type, external)
  private
  public :: tell_mesh, mesh_bytes, pad_bytes_of_patch, search_words, write_mesh_summary, particles_put_back, points_beyond

  integer, parameter :: columns = 110 !! a longer list goes on in the next line
  !> Places in the books of a search
  integer, parameter :: visits = 1, left = sum_left - sum_visits + 1, by_velocity = sum_by_velocity - sum_visits + 1, &
    by_walk = sum_by_walk - sum_visits + 1, by_rings = sum_by_rings - sum_visits + 1, put_back = sum_put_back - sum_visits + 1, &
    beyond = sum_beyond - sum_visits + 1

contains

  !> Lines of the header
  subroutine tell_mesh(engine, walls, file)
    type(engine_t), intent(in) :: engine
    type(walls_t), intent(in) :: walls
    character(len=*), intent(in) :: file
    character(len=:), allocatable :: kinds
    integer :: kind, n
    associate (mesh => engine%mesh)
      kinds = ""
      do kind = 1, n_kinds
        n = count(mesh%kind == kind)
        if (n == 0) cycle
        if (kinds /= "") kinds = kinds//" and "
        kinds = kinds//with_thousands(int(n, i8))//" "//trim(kind_name(kind))
      end do
      write (output_unit, "(a)") "  mesh       "//file//": "//kinds//", "//with_thousands(int(mesh%nodes, i8))//" nodes, " &
        //with_thousands(int(engine%patches%n, i8))//" patches; "//short_number(real(mesh_bytes(engine), dp))//"B on each rank", &
        "             reference length "//text_of(engine%grid%spacing, 4)//" m, least height of an element "//text_of(least_spacing(engine), 4)//" m"
    end associate
    call tell_sides(engine%mesh, walls)
  end subroutine tell_mesh

  !> Named sides with their conditions, those without one last
  subroutine tell_sides(mesh, walls)
    type(mesh_t), intent(in) :: mesh
    type(walls_t), intent(in) :: walls
    character(len=:), allocatable :: line
    integer :: k, n
    line = "  sides      "
    do k = 1, size(mesh%side_group_name)
      n = count(mesh%side_group == k)
      if (n == 0) cycle
      call add(trim(mesh%side_group_name(k))//" ("//with_thousands(int(n, i8))//"): "//condition_words(k))
    end do
    n = count(mesh%side_group == 0)
    if (n > 0) call add("without a name ("//with_thousands(int(n, i8))//"): free")
    write (output_unit, "(a)") line

  contains

    subroutine add(item)
      character(len=*), intent(in) :: item
      if (len(line) > 13) line = line//"; "
      if (len(line) + len(item) > columns .and. len(line) > 13) then
        write (output_unit, "(a)") trim(line)
        line = repeat(" ", 13)
      end if
      line = line//item
    end subroutine add

    pure function condition_words(group) result(words)
      integer, intent(in) :: group
      character(len=:), allocatable :: words
      select case (walls%group(group)%condition)
      case (side_stick); words = "stick"
      case (side_slip); words = "slip"
      case (side_symmetry); words = "symmetry"
      case (side_velocity); words = "velocity"
      case default
        words = "free"
        if (walls%group(group)%removes) words = "free, removes"
      end select
    end function condition_words

  end subroutine tell_sides

  !> Bytes of the mesh with its tables for search and patches, the same on every rank
  pure integer(i8) function mesh_bytes(engine) result(bytes)
    type(engine_t), intent(in) :: engine
    integer(i8) :: reals, wholes
    bytes = 0
    if (.not. engine%grid%is_mesh) return
    associate (mesh => engine%mesh, locator => engine%locator, patches => engine%patches)
      reals = size(mesh%x, kind=i8) + size(locator%plane, kind=i8) + size(locator%centre, kind=i8) + size(locator%reach, kind=i8)
      wholes = size(mesh%node, kind=i8) + size(mesh%across, kind=i8) + size(mesh%vertex_first, kind=i8) &
               + size(mesh%vertex_element, kind=i8) + 3_i8*mesh%elements + mesh%nodes + 3*size(mesh%side_group, kind=i8) &
               + size(locator%bucket_first, kind=i8) + size(locator%bucket_element, kind=i8) + size(patches%of_element, kind=i8) &
               + 5*size(patches%pad_node, kind=i8)
    end associate
    bytes = reals*(storage_size(1.0_wp)/8) + wholes*(storage_size(1)/8)
  end function mesh_bytes

  !> Bytes of the largest pad of a patch
  pure integer(i8) function pad_bytes_of_patch(engine) result(bytes)
    type(engine_t), intent(in) :: engine
    bytes = int(storage_size(1.0_wp)/8*fields_per_node, i8)*engine%patches%most_pad
  end function pad_bytes_of_patch

  !> A line of the closing table: what finding the elements took
  function search_words(books, particle_steps) result(words)
    type(books_t), intent(in) :: books
    integer(i8), intent(in) :: particle_steps
    character(len=:), allocatable :: words
    real(dp) :: leaves
    leaves = real(max(1_i8, books%search(left)), dp)
    words = text_of(visits_a_step(books, particle_steps), 4)//" elements asked for each particle and step; " &
            //text_of(100.0_dp*leaves_a_step(books, particle_steps), 3)//" % left theirs"
    if (books%search(left) > 0) words = words//", found by velocity "//percent(by_velocity)//", by a walk "//percent(by_walk) &
                                        //", in rings or buckets "//percent(by_rings)
  contains
    function percent(k) result(text)
      integer, intent(in) :: k
      character(len=:), allocatable :: text
      text = text_of(100.0_dp*books%search(k)/leaves, 3)//" %"
    end function percent
  end function search_words

  pure real(dp) function visits_a_step(books, particle_steps)
    type(books_t), intent(in) :: books
    integer(i8), intent(in) :: particle_steps
    visits_a_step = 1.0_dp + real(books%search(visits), dp)/max(1_i8, particle_steps)
  end function visits_a_step

  pure real(dp) function leaves_a_step(books, particle_steps)
    type(books_t), intent(in) :: books
    integer(i8), intent(in) :: particle_steps
    leaves_a_step = real(books%search(left), dp)/max(1_i8, particle_steps)
  end function leaves_a_step

  !> Particles put back onto a side, so often
  pure integer(i8) function particles_put_back(books) result(n)
    type(books_t), intent(in) :: books
    n = books%search(put_back)
  end function particles_put_back

  !> Points of domains that were beyond the mesh, so often
  pure integer(i8) function points_beyond(books) result(n)
    type(books_t), intent(in) :: books
    n = books%search(beyond)
  end function points_beyond

  !> The same as attributes of /summary
  subroutine write_mesh_summary(output, engine, books, particle_steps, error)
    type(output_file_t), intent(inout) :: output
    type(engine_t), intent(in) :: engine
    type(books_t), intent(in) :: books
    integer(i8), intent(in) :: particle_steps
    type(error_t), allocatable, intent(inout) :: error
    real(dp) :: leaves
    leaves = real(max(1_i8, books%search(left)), dp)
    call word("mesh_hash", mesh_hash(engine%mesh, engine%grid))
    call count("mesh_elements", int(engine%mesh%elements, i8))
    call count("mesh_nodes", int(engine%mesh%nodes, i8))
    call count("mesh_patches", int(engine%patches%n, i8))
    call count("mesh_bytes", mesh_bytes(engine))
    call number("search_visits", visits_a_step(books, particle_steps))
    call number("search_leaves", leaves_a_step(books, particle_steps))
    call number("search_by_velocity", books%search(by_velocity)/leaves)
    call number("search_by_walk", books%search(by_walk)/leaves)
    call number("search_by_rings", books%search(by_rings)/leaves)
    call count("search_put_back", books%search(put_back))
    call count("search_beyond", books%search(beyond))

  contains

    subroutine number(name, value)
      character(len=*), intent(in) :: name
      real(dp), intent(in) :: value
      if (.not. allocated(error)) call put_summary(output, name, value, error)
    end subroutine number

    subroutine count(name, value)
      character(len=*), intent(in) :: name
      integer(i8), intent(in) :: value
      if (.not. allocated(error)) call put_summary(output, name, value, error)
    end subroutine count

    subroutine word(name, value)
      character(len=*), intent(in) :: name, value
      if (.not. allocated(error)) call put_summary(output, name, value, error)
    end subroutine word

  end subroutine write_mesh_summary

end module gimp_mesh_report
