!> Particle files come back as written, and every fault in one is told
program test_particle_file
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use gimp_common_kinds, only: dp, i8
  use gimp_shares, only: share_t
  use gimp_error, only: error_t, report_lines
  use gimp_file_system, only: file_exists, delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, write_dataset, read_attribute
  use gimp_particle_file, only: particle_table_t, read_particle_file, write_particle_file
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_particles.h5"
  type(error_t), allocatable :: error
  call begin_suite("particle_file")
  call comes_back()
  call shares_of_rows()
  call faults_are_told()
  call delete_file(name, error)
  call end_suite()

contains

  !> Three particles in two dimensions
  subroutine sample(table)
    type(particle_table_t), intent(out) :: table
    integer :: k
    table%position = reshape([(0.1_dp*k, k=1, 6)], [2, 3])
    table%volume = [1.0_dp, 2.0_dp, 3.0_dp]
    table%mass = [10.0_dp, 20.0_dp, 30.0_dp]
  end subroutine sample

  subroutine comes_back()
    type(particle_table_t) :: table, back
    type(hdf5_file_t) :: file
    character(len=:), allocatable :: reason
    integer(i8) :: step
    integer :: k
    call sample(table)
    table%velocity = -table%position
    table%deformation_gradient = reshape([(1.0_dp/k, k=1, 12)], [4, 3])
    table%half_length = 2.0_dp*table%position
    table%stress = reshape([(1.0e6_dp*k, k=1, 18)], [6, 3])
    table%id = [7_i8, 2_i8**40, 1_i8]
    call write_particle_file(name, table, error, reason="inverted particle 7", step=12_i8, time=0.25_dp)
    call check_true(.not. allocated(error), "write")
    call check_true(.not. file_exists(name//".part"), "the temporary name is gone")
    call read_particle_file(name, 2, back, error)
    call check_true(.not. allocated(error), "read")
    if (allocated(error)) return
    call check_true(back%n == 3 .and. back%dimension == 2, "sizes")
    call check_true(all(back%position == table%position) .and. all(back%velocity == table%velocity), "position, velocity")
    call check_true(all(back%deformation_gradient == table%deformation_gradient), "deformation gradient")
    call check_true(all(back%half_length == table%half_length) .and. all(back%stress == table%stress), "half length, stress")
    call check_true(all(back%id == table%id), "id")
    call check(back%volume, table%volume, 0.0_dp, "volume")
    call open_hdf5(name, "read", file, error)
    call read_attribute(file, "", "reason", reason, error)
    call read_attribute(file, "", "step", step, error)
    call close_hdf5(file, error)
    call check(reason, "inverted particle 7", "reason of a failed run")
    call check_true(step == 12, "step of a failed run")
    call sample(table)
    deallocate (table%velocity, table%id, stat=k)
    call write_particle_file(name, table, error)
    call read_particle_file(name, 2, back, error)
    call check_true(.not. (allocated(back%velocity) .or. allocated(back%id)), "what is not in the file is not allocated")
    call vector_in_one_dimension()
  end subroutine comes_back

  !> Shares of the rows make the whole file, and a mistake names the row in the file
  subroutine shares_of_rows()
    type(particle_table_t) :: table, part
    integer(i8) :: rows
    integer :: k, shares
    call sample(table)
    table%stress = reshape([(1.0e6_dp*k, k=1, 18)], [6, 3])
    table%id = [7_i8, 2_i8**40, 1_i8]
    call write_particle_file(name, table, error)
    do shares = 1, 4 ! one more than there are rows
      rows = 0
      do k = 0, shares - 1
        call read_particle_file(name, 2, part, error, share_t(k, shares))
        call check_true(.not. allocated(error), "share is read")
        if (allocated(error)) return
        call check_true(part%first == rows + 1 .and. size(part%volume) == part%n .and. allocated(part%stress) .and. &
                        .not. allocated(part%velocity), "share: rows, and what the file has")
        associate (last => rows + part%n)
          call check_true(all(part%position == table%position(:, rows + 1:last)) .and. all(part%mass == table%mass(rows + 1:last)) &
            .and. all(part%stress == table%stress(:, rows + 1:last)) .and. all(part%id == table%id(rows + 1:last)), "share: values")
        end associate
        rows = rows + part%n
      end do
      call check(int(rows), 3, "shares: all rows")
    end do
    table%mass(3) = -1.0_dp
    call write_particle_file(name, table, error)
    call read_particle_file(name, 2, part, error, share_t(1, 2))
    call told("negative mass in the second share", "mass of particle 3 is -1; must be positive")
    call read_particle_file(name, 2, part, error, share_t(0, 2))
    call check_true(.not. allocated(error), "the first share is sound")
  end subroutine shares_of_rows

  subroutine vector_in_one_dimension()
    type(particle_table_t) :: back
    type(hdf5_file_t) :: file
    call open_hdf5(name, "overwrite", file, error)
    call write_dataset(file, "position", [0.5_dp, 1.5_dp], error)
    call write_dataset(file, "velocity", [1.0_dp, 2.0_dp], error)
    call write_dataset(file, "volume", [1_i8, 2_i8], error)
    call write_dataset(file, "mass", [1.0_dp, 2.0_dp], error)
    call close_hdf5(file, error)
    call read_particle_file(name, 1, back, error)
    call check_true(.not. allocated(error), "one dimension takes plain vectors")
    if (allocated(error)) return
    call check(back%position(1, :), [0.5_dp, 1.5_dp], 0.0_dp, "positions on a line")
    call check(back%volume, [1.0_dp, 2.0_dp], 0.0_dp, "integers are read as reals")
  end subroutine vector_in_one_dimension

  subroutine told(what, part)
    character(len=*), intent(in) :: what, part
    call check_true(allocated(error), what)
    if (.not. allocated(error)) return
    call check_true(index(error%message, part) > 0, what//" says '"//part//"': "//error%message)
    call check_true(index(error%message, name) > 0, what//" names the file")
  end subroutine told

  subroutine try(table, dimension)
    type(particle_table_t), intent(in) :: table
    integer, intent(in) :: dimension
    type(particle_table_t) :: back
    call write_particle_file(name, table, error)
    call check_true(.not. allocated(error), "a faulty table can be written")
    call read_particle_file(name, dimension, back, error)
  end subroutine try

  subroutine faults_are_told()
    type(particle_table_t) :: table, back
    type(hdf5_file_t) :: file
    call sample(table)
    call try(table, 3)
    call told("wrong dimension", "position has shape (3, 2); must be (3, 3)")
    table%volume(2) = -1.0_dp
    table%mass(3) = ieee_value(1.0_dp, ieee_quiet_nan)
    call try(table, 2)
    call told("negative volume", "volume of particle 2 is -1; must be positive")
    call told("undefined mass", "mass of particle 3 is not a finite number")
    call check(report_lines(error), 2, "both faults at once")
    call sample(table)
    table%position(1, 2) = ieee_value(1.0_dp, ieee_quiet_nan)
    call try(table, 2)
    call told("undefined position", "position of particle 2")
    call sample(table)
    table%volume = [1.0_dp]
    table%stress = reshape([1.0_dp, 2.0_dp], [2, 1])
    call try(table, 2)
    call told("too few volumes", "volume has 1 values for 3 particles")
    call told("stress of wrong shape", "stress has shape (1, 2); must be (3, 6)")
    call open_hdf5(name, "overwrite", file, error)
    call write_dataset(file, "position", reshape([0.5_dp, 1.5_dp], [2, 1]), error)
    call write_dataset(file, "volume", [1.0_dp], error)
    call close_hdf5(file, error)
    call read_particle_file(name, 2, back, error)
    call told("missing mass", "no dataset mass")
    call open_hdf5(name, "overwrite", file, error)
    call close_hdf5(file, error)
    call read_particle_file(name, 2, back, error)
    call told("empty file", "no dataset position")
    call delete_file(name, error)
    call read_particle_file(name, 2, back, error)
    call told("missing file", "no such file")
    deallocate (table%mass)
    call write_particle_file(name, table, error)
    call told("a table without mass", "needs position, volume and mass")
  end subroutine faults_are_told

end program test_particle_file
