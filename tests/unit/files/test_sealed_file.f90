!> A seal tells every changed byte, and leaves the HDF5 file readable
program test_sealed_file
  use, intrinsic :: iso_c_binding, only: c_loc
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_text, only: text_of
  use gimp_file_system, only: delete_file, raw_file_t, open_raw_file, write_at, close_raw_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_dataset, write_dataset
  use gimp_sealed_file, only: seal_file, check_seal, seal_bytes
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_sealed_file.h5", kind = "thing of the test"
  type(error_t), allocatable :: error
  call begin_suite("sealed_file")
  call sealed()
  call every_byte_counts()
  call told_in_words()
  call delete_file(name, error)
  call end_suite()

contains

  subroutine make_file(values)
    real(dp), intent(in) :: values(:)
    type(hdf5_file_t) :: file
    call open_hdf5(name, "overwrite", file, error, user_block=seal_bytes)
    call write_dataset(file, "values", values, error)
    call close_hdf5(file, error)
    call seal_file(name, kind, 3, error)
    call check_true(.not. allocated(error), "a file is sealed")
  end subroutine make_file

  subroutine sealed()
    type(hdf5_file_t) :: file
    real(dp), allocatable :: values(:)
    integer :: k
    call make_file([(real(k, dp), k=1, 300000)]) ! more than is read at a time
    call check_seal(name, kind, 3, error)
    call check_true(.not. allocated(error), "the seal is sound")
    call open_hdf5(name, "read", file, error)
    call read_dataset(file, "values", values, error)
    call check(values, [(real(k, dp), k=1, 300000)], 0.0_dp, "the library reads behind the seal")
    call close_hdf5(file, error)
  end subroutine sealed

  !> One bit of each byte in turn; then bytes cut off, added and exchanged
  subroutine every_byte_counts()
    character(len=1), allocatable :: bytes(:), others(:)
    character(len=1), target :: flipped
    type(raw_file_t) :: raw
    integer :: k, unnoticed
    call make_file([1.0_dp, 2.0_dp, 3.0_dp])
    call read_bytes(bytes)
    unnoticed = 0
    call open_raw_file(name, raw, error)
    do k = 1, size(bytes)
      flipped = achar(ieor(iachar(bytes(k)), ishft(1, modulo(k, 8))))
      call write_at(raw, k - 1_i8, c_loc(flipped), 1_i8, error)
      call check_seal(name, kind, 3, error)
      if (.not. allocated(error)) unnoticed = unnoticed + 1
      flipped = bytes(k)
      call write_at(raw, k - 1_i8, c_loc(flipped), 1_i8, error)
    end do
    call close_raw_file(raw, error)
    call check(unnoticed, 0, "changed bytes that go unnoticed, of "//text_of(size(bytes)))
    call write_bytes(bytes(:size(bytes) - 1))
    call check_seal(name, kind, 3, error)
    call check_true(allocated(error), "a file cut short")
    call write_bytes([bytes, " "])
    call check_seal(name, kind, 3, error)
    call check_true(allocated(error), "a longer file")
    others = bytes
    others(601:608) = bytes(609:616)
    others(609:616) = bytes(601:608)
    call write_bytes(others)
    call check_seal(name, kind, 3, error)
    call check_true(allocated(error) .or. all(others == bytes), "words exchanged")
    call write_bytes(bytes)
    call check_seal(name, kind, 3, error)
    call check_true(.not. allocated(error), "and the file as it was is sound")
  end subroutine every_byte_counts

  subroutine told_in_words()
    call make_file([1.0_dp])
    call check_seal(name, "another thing", 3, error)
    call check(error%message, name//": is not a another thing", "kind")
    call check_seal(name, kind, 2, error)
    call check(error%message, name//": has format version 3, newer than the 2 that this program knows", "version")
    call write_bytes(["H", "i"])
    call check_seal(name, kind, 3, error)
    call check(error%message, name//": is not a "//kind, "a file that is no such thing")
    call delete_file(name, error)
    call check_seal(name, kind, 3, error)
    call check(error%message, name//": no such file", "a file that is not there")
  end subroutine told_in_words

  subroutine read_bytes(bytes)
    character(len=1), allocatable, intent(out) :: bytes(:)
    integer :: unit, length
    inquire (file=name, size=length)
    allocate (bytes(length))
    open (newunit=unit, file=name, access="stream", form="unformatted", action="read", status="old")
    read (unit) bytes
    close (unit)
  end subroutine read_bytes

  subroutine write_bytes(bytes)
    character(len=1), intent(in) :: bytes(:)
    integer :: unit
    open (newunit=unit, file=name, access="stream", form="unformatted", action="write", status="replace")
    write (unit) bytes
    close (unit)
  end subroutine write_bytes

end program test_sealed_file
