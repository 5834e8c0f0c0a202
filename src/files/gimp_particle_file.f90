!> Particles in an HDF5 file: a body made elsewhere, the state of a failed run, the starting state of a test.
!>
!> Datasets (shapes as Python sees them; transposed here): `position` (n, d), `volume` (n), `mass` (n), and optionally
!> `velocity` (n, d), `deformation_gradient` (n, d*d) row by row, `half_length` (n, d), `stress` (n, 6) in the order xx, yy, zz, xy,
!> yz, zx, `id` (n), `corner` (n, corners*d) of the domain as meshes number them, one corner after the other. SI units. Any kind of
!> real number is accepted; writing is in double precision. Each rank reads and writes rows of its own.
module gimp_particle_file
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise, add_error
  use gimp_text, only: text_of
  use gimp_shares, only: share_t, items_of_share
  use gimp_ranks, only: this_rank
  use gimp_over_ranks, only: share_error
  use gimp_file_system, only: rename_file, delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, has_dataset, dataset_shape, read_dataset, write_attribute
  use gimp_shared_hdf5, only: shared_file_t, lay_out, announce_rows, end_layout, write_rows, close_shared, drop_shared
  implicit none(type, external)
  private
  public :: particle_table_t, read_particle_file, write_particle_file

  !> The content of a particle file; what is not in the file is not allocated
  type :: particle_table_t
    integer(i8) :: n = 0 !! particles here
    integer(i8) :: first = 1 !! row of the first of them in the file
    integer :: dimension = 0 !! d
    real(dp), allocatable :: position(:, :) !! (d, n) [m]
    real(dp), allocatable :: volume(:) !! (n) present volume [m3]; in two dimensions per metre of depth
    real(dp), allocatable :: mass(:) !! (n) [kg]
    real(dp), allocatable :: velocity(:, :) !! (d, n) [m/s]
    real(dp), allocatable :: deformation_gradient(:, :) !! (d*d, n) row by row
    real(dp), allocatable :: half_length(:, :) !! (d, n) half the edge of the particle's domain [m]
    real(dp), allocatable :: corner(:, :) !! (corners*d, n) of the particle's domain: 2^d, or d+1 of a simplex [m]
    real(dp), allocatable :: stress(:, :) !! (6, n) Cauchy stress [Pa]
    integer(i8), allocatable :: id(:) !! (n)
  end type particle_table_t

contains

  !> Read a particle file, or a share of its rows, and check it: every mistake in it is told at once, the same on all ranks.
  !> Collective
  subroutine read_particle_file(path, dimension, table, error, share)
    character(len=*), intent(in) :: path
    integer, intent(in) :: dimension !! of the scene: 1, 2 or 3
    type(particle_table_t), intent(out) :: table
    type(error_t), allocatable, intent(out) :: error
    type(share_t), intent(in), optional :: share !! of the rows; all
    type(hdf5_file_t) :: file
    type(error_t), allocatable :: ignored
    type(share_t) :: mine
    if (present(share)) mine = share
    call open_hdf5(path, "read", file, error)
    if (.not. allocated(error)) then
      call read_tables(file, dimension, mine, table, error)
      call close_hdf5(file, ignored) ! nothing can be lost by reading
    end if
    call share_error(error)
    if (allocated(error)) return
    call check_numbers(path, table, error)
  end subroutine read_particle_file

  subroutine read_tables(file, dimension, share, table, error)
    type(hdf5_file_t), intent(in) :: file
    integer, intent(in) :: dimension
    type(share_t), intent(in) :: share
    type(particle_table_t), intent(inout) :: table
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: extents(:)
    integer(i8) :: n, rows(2)
    if (.not. has_dataset(file, "position")) then
      call raise(error, file%path//": no dataset position; a particle file needs position, volume and mass")
      return
    end if
    call dataset_shape(file, "position", extents, error)
    if (allocated(error)) return
    if (size(extents) == 1 .and. dimension == 1) extents = [1_i8, extents] ! a plain vector will do in one dimension
    if (size(extents) /= 2) then
      call raise(error, file%path//": position has "//text_of(size(extents))//" dimensions; must be (particles, " &
        //text_of(dimension)//")")
      return
    end if
    n = extents(2)
    if (n == 0) then
      call raise(error, file%path//": holds no particles")
      return
    end if
    rows = items_of_share(share, n)
    table%first = rows(1)
    table%n = rows(2) - rows(1) + 1
    table%dimension = dimension
    call read_matrix(file, "position", dimension, n, rows, .true., table%position, error)
    call read_vector(file, "volume", n, rows, table%volume, error)
    call read_vector(file, "mass", n, rows, table%mass, error)
    call read_matrix(file, "velocity", dimension, n, rows, .false., table%velocity, error)
    call read_matrix(file, "deformation_gradient", dimension**2, n, rows, .false., table%deformation_gradient, error)
    call read_matrix(file, "half_length", dimension, n, rows, .false., table%half_length, error)
    call read_matrix(file, "corner", corner_numbers(file, dimension), n, rows, .false., table%corner, error)
    call read_matrix(file, "stress", 6, n, rows, .false., table%stress, error)
    call read_ids(file, n, rows, table%id, error)
  end subroutine read_tables

  !> Numbers for the corners of a particle: those of a box, unless the file has those of a simplex
  integer function corner_numbers(file, d) result(n)
    type(hdf5_file_t), intent(in) :: file
    integer, intent(in) :: d
    type(error_t), allocatable :: ignored
    integer(i8), allocatable :: extents(:)
    n = d*2**d
    if (.not. has_dataset(file, "corner")) return
    call dataset_shape(file, "corner", extents, ignored)
    if (size(extents) == 2) then
      if (extents(1) == d*(d + 1)) n = d*(d + 1)
    end if
  end function corner_numbers

  !> Some rows of a matrix of `components`; with one component a vector is accepted
  subroutine read_matrix(file, name, components, n, rows, needed, values, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: name
    integer, intent(in) :: components
    integer(i8), intent(in) :: n !! particles in the file
    integer(i8), intent(in) :: rows(2) !! first and last to read
    logical, intent(in) :: needed
    real(dp), allocatable, intent(out) :: values(:, :)
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: fault
    real(dp), allocatable :: vector(:)
    integer(i8), allocatable :: extents(:)
    if (.not. has_dataset(file, name)) then
      if (needed) call add_error(error, file%path//": no dataset "//name)
      return
    end if
    call dataset_shape(file, name, extents, fault)
    if (size(extents) == 1 .and. components == 1) extents = [1_i8, extents]
    if (size(extents) /= 2) then
      call add_error(error, file%path//": "//name//" has "//text_of(size(extents))//" dimensions; must be ("//text_of(n) &
        //", "//text_of(components)//")")
      return
    else if (any(extents /= [int(components, i8), n])) then
      call add_error(error, file%path//": "//name//" has shape ("//text_of(extents(2))//", "//text_of(extents(1)) &
        //"); must be ("//text_of(n)//", "//text_of(components)//")")
      return
    end if
    call dataset_shape(file, name, extents, fault)
    if (size(extents) == 1) then
      call read_dataset(file, name, vector, fault, rows)
      if (.not. allocated(fault)) values = reshape(vector, [1_i8, size(vector, kind=i8)])
    else
      call read_dataset(file, name, values, fault, rows)
    end if
    if (allocated(fault)) call add_error(error, fault%message)
  end subroutine read_matrix

  subroutine read_vector(file, name, n, rows, values, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: n, rows(2) !! as of `read_matrix`
    real(dp), allocatable, intent(out) :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: fault
    call check_values(file, name, n, fault)
    if (.not. allocated(fault)) call read_dataset(file, name, values, fault, rows)
    if (allocated(fault)) call add_error(error, fault%message)
  end subroutine read_vector

  subroutine read_ids(file, n, rows, id, error)
    type(hdf5_file_t), intent(in) :: file
    integer(i8), intent(in) :: n, rows(2) !! as of `read_matrix`
    integer(i8), allocatable, intent(out) :: id(:)
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: fault
    if (.not. has_dataset(file, "id")) return
    call check_values(file, "id", n, fault)
    if (.not. allocated(fault)) call read_dataset(file, "id", id, fault, rows)
    if (allocated(fault)) call add_error(error, fault%message)
  end subroutine read_ids

  !> A vector needs a value for each particle
  subroutine check_values(file, name, n, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: n
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: extents(:)
    call dataset_shape(file, name, extents, error)
    if (allocated(error) .or. size(extents) /= 1) return ! reading tells of other shapes
    if (extents(1) /= n) call raise(error, file%path//": "//name//" has "//text_of(extents(1))//" values for "//text_of(n) &
      //" particles")
  end subroutine check_values

  !> Values that no particle can have; of each quantity the first is told. Collective
  subroutine check_numbers(path, table, error)
    character(len=*), intent(in) :: path
    type(particle_table_t), intent(in) :: table
    type(error_t), allocatable, intent(out) :: error
    call check_finite("position", table%position)
    call check_finite("velocity", table%velocity)
    call check_finite("deformation_gradient", table%deformation_gradient)
    call check_finite("half_length", table%half_length)
    call check_finite("corner", table%corner)
    call check_finite("stress", table%stress)
    call check_positive("volume", table%volume)
    call check_positive("mass", table%mass)
  contains
    subroutine check_finite(name, values)
      character(len=*), intent(in) :: name
      real(dp), allocatable, intent(in) :: values(:, :)
      type(error_t), allocatable :: fault
      integer(i8) :: p
      if (.not. allocated(values)) return
      do p = 1, size(values, 2, kind=i8)
        if (all(is_number(values(:, p)))) cycle
        call raise(fault, path//": "//name//" of particle "//text_of(table%first + p - 1)//" is not a finite number")
        exit
      end do
      call share_error(fault) ! the lowest rank has the lowest rows
      if (allocated(fault)) call add_error(error, fault%message)
    end subroutine check_finite

    subroutine check_positive(name, values)
      character(len=*), intent(in) :: name
      real(dp), intent(in) :: values(:)
      type(error_t), allocatable :: fault
      integer(i8) :: p
      do p = 1, size(values, kind=i8)
        if (.not. is_number(values(p))) then
          call raise(fault, path//": "//name//" of particle "//text_of(table%first + p - 1)//" is not a finite number")
        else if (values(p) <= 0.0_dp) then
          call raise(fault, path//": "//name//" of particle "//text_of(table%first + p - 1)//" is "//text_of(values(p)) &
            //"; must be positive")
        end if
        if (allocated(fault)) exit
      end do
      call share_error(fault)
      if (allocated(fault)) call add_error(error, fault%message)
    end subroutine check_positive
  end subroutine check_numbers

  !> Neither infinite nor NaN; the first comparison keeps NaN from raising an exception in the second
  elemental logical function is_number(value)
    real(dp), intent(in) :: value
    is_number = .false.
    if (value /= value) return
    is_number = abs(value) <= huge(value)
  end function is_number

  !> Write a particle file: whole or not at all (it gets its name when it is complete). The particles of rank 0 come first, then
  !> those of rank 1, and so on. The state of a failed run also says why, when and where it failed. Collective
  subroutine write_particle_file(path, table, error, reason, step, time)
    character(len=*), intent(in) :: path !! an existing file is replaced
    type(particle_table_t), intent(in) :: table !! of this rank: position, volume and mass at least; n and dimension follow from them
    type(error_t), allocatable, intent(out) :: error
    character(len=*), intent(in), optional :: reason !! attributes of the file
    integer(i8), intent(in), optional :: step
    real(dp), intent(in), optional :: time !! [s]
    type(shared_file_t) :: shared
    type(error_t), allocatable :: ignored
    if (.not. (allocated(table%position) .and. allocated(table%volume) .and. allocated(table%mass))) then
      call raise(error, path//": a particle file needs position, volume and mass")
      return
    end if
    call lay_out(path//".part", shared, error)
    if (.not. allocated(error)) then
      if (this_rank == 0) call write_attributes(shared%file, error, reason, step, time)
      call share_error(error)
    end if
    if (.not. allocated(error)) call write_tables(shared, table, error)
    if (.not. allocated(error)) then
      if (this_rank == 0) call rename_file(path//".part", path, error)
      call share_error(error)
    end if
    if (.not. allocated(error)) return
    call drop_shared(shared)
    if (this_rank == 0) call delete_file(path//".part", ignored)
  end subroutine write_particle_file

  subroutine write_attributes(file, error, reason, step, time)
    type(hdf5_file_t), intent(in) :: file
    type(error_t), allocatable, intent(out) :: error
    character(len=*), intent(in), optional :: reason
    integer(i8), intent(in), optional :: step
    real(dp), intent(in), optional :: time
    if (present(reason)) call write_attribute(file, "", "reason", reason, error)
    if (present(step) .and. .not. allocated(error)) call write_attribute(file, "", "step", step, error)
    if (present(time) .and. .not. allocated(error)) call write_attribute(file, "", "time", time, error)
  end subroutine write_attributes

  !> Make room for all particles, then write those of this rank. Collective
  subroutine write_tables(shared, table, error)
    type(shared_file_t), intent(inout) :: shared
    type(particle_table_t), intent(in) :: table
    type(error_t), allocatable, intent(out) :: error
    integer :: pass
    do pass = 1, 2 ! announce, then write
      call put("position", table%position)
      call put_vector("volume", table%volume)
      call put_vector("mass", table%mass)
      call put("velocity", table%velocity)
      call put("deformation_gradient", table%deformation_gradient)
      call put("half_length", table%half_length)
      call put("corner", table%corner)
      call put("stress", table%stress)
      if (allocated(table%id) .and. pass == 1) call announce_rows(shared, "id", "int64", size(table%id, kind=i8))
      if (allocated(table%id) .and. pass == 2 .and. .not. allocated(error)) call write_rows(shared, "id", 1_i8, table%id, error)
      if (pass == 1) call end_layout(shared, error)
      if (pass == 1 .and. allocated(error)) return
    end do
    call close_shared(shared, error)
  contains
    subroutine put(name, values)
      character(len=*), intent(in) :: name
      real(dp), allocatable, intent(in) :: values(:, :)
      if (.not. allocated(values)) return
      if (pass == 1) call announce_rows(shared, name, "double", size(values, 2, kind=i8), width=size(values, 1))
      if (pass == 2 .and. .not. allocated(error)) call write_rows(shared, name, 1_i8, values, error)
    end subroutine put

    subroutine put_vector(name, values)
      character(len=*), intent(in) :: name
      real(dp), intent(in) :: values(:)
      if (pass == 1) call announce_rows(shared, name, "double", size(values, kind=i8))
      if (pass == 2 .and. .not. allocated(error)) call write_rows(shared, name, 1_i8, values, error)
    end subroutine put_vector
  end subroutine write_tables

end module gimp_particle_file
