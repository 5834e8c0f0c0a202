!> A seal tells every changed byte, and leaves the HDF5 file readable; also when several ranks look at it
program test_sealed_file
  use, intrinsic :: iso_c_binding, only: c_loc
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_text, only: text_of
  use gimp_shares, only: share_t
  use gimp_ranks, only: this_rank, start_ranks, end_ranks, wait_for_ranks
  use gimp_file_system, only: file_bytes, delete_file, raw_file_t, open_raw_file, write_at, close_raw_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_dataset, write_dataset
  use gimp_sealed_file, only: seal_file, check_seal, hash_pieces, seal_bytes
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_sealed_file.h5", kind = "thing of the test"
  type(error_t), allocatable :: error
  call start_ranks()
  call begin_suite("sealed_file")
  call sealed()
  call shares_make_the_whole()
  call every_byte_counts()
  call told_in_words()
  call end_suite()
  call end_ranks(0)

contains

  subroutine make_file(values)
    real(dp), intent(in) :: values(:)
    type(hdf5_file_t) :: file
    call wait_for_ranks()
    if (this_rank == 0) then
      call open_hdf5(name, "overwrite", file, error, user_block=seal_bytes)
      call write_dataset(file, "values", values, error)
      call close_hdf5(file, error)
    end if
    call wait_for_ranks()
    call seal_file(name, kind, 3, error)
    call check_true(.not. allocated(error), "a file is sealed")
  end subroutine make_file

  subroutine sealed()
    type(hdf5_file_t) :: file
    real(dp), allocatable :: values(:), expected(:)
    integer :: k
    allocate (expected(900000)) ! more than is read at a time
    do k = 1, size(expected)
      expected(k) = k
    end do
    call make_file(expected)
    call check_seal(name, kind, 3, error)
    call check_true(.not. allocated(error), "the seal is sound")
    call open_hdf5(name, "read", file, error)
    call read_dataset(file, "values", values, error)
    call check(values, expected, 0.0_dp, "the library reads behind the seal")
    call close_hdf5(file, error)
  end subroutine sealed

  !> However the pieces are shared out, their hashes add up to the same; pieces that change places are noticed
  subroutine shares_make_the_whole()
    character(len=1), allocatable :: bytes(:), others(:)
    integer(i8) :: whole, part, total
    integer :: k, n
    call hash_pieces(name, file_bytes(name), share_t(), whole, error)
    do n = 2, 6 ! there are four pieces
      total = 0
      do k = 0, n - 1
        call hash_pieces(name, file_bytes(name), share_t(k, n), part, error)
        call check_true(.not. allocated(error), "a share of the pieces")
        total = total + part
      end do
      call check_true(total == whole, text_of(n)//" shares")
    end do
    call read_bytes(bytes)
    others = bytes
    others(513:512 + 2**21) = bytes(513 + 2**21:512 + 2**22)
    others(513 + 2**21:512 + 2**22) = bytes(513:512 + 2**21)
    call write_bytes(others)
    call check_seal(name, kind, 3, error)
    call check_true(allocated(error), "pieces exchanged")
    call write_bytes(bytes(:2**21))
    call hash_pieces(name, int(size(bytes), i8), share_t(), whole, error)
    call check_true(allocated(error), "a file that ends early")
  end subroutine shares_make_the_whole

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
      if (this_rank == 0) call write_at(raw, k - 1_i8, c_loc(flipped), 1_i8, error)
      call wait_for_ranks()
      call check_seal(name, kind, 3, error)
      if (.not. allocated(error)) unnoticed = unnoticed + 1
      call wait_for_ranks()
      flipped = bytes(k)
      if (this_rank == 0) call write_at(raw, k - 1_i8, c_loc(flipped), 1_i8, error)
    end do
    call close_raw_file(raw, error)
    call check(unnoticed, 0, "changed bytes that go unnoticed, of "//text_of(size(bytes)))
    call write_bytes(bytes(:size(bytes) - 1))
    call check_seal(name, kind, 3, error)
    call check_true(allocated(error), "a file cut short")
    unnoticed = 0
    do k = 1, size(bytes), 37
      call write_bytes(bytes(:k - 1))
      call check_seal(name, kind, 3, error)
      if (.not. allocated(error)) unnoticed = unnoticed + 1
    end do
    call check(unnoticed, 0, "a file cut short anywhere")
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
    call check_seal(name, kind, 4, error)
    call check(error%message, name//": has format version 3, older than the 4 that this program knows; " &
      //"the gimp.x that wrote it can go on from it", "older version")
    call write_bytes(["H", "i"])
    call check_seal(name, kind, 3, error)
    call check(error%message, name//": is not a "//kind, "a file that is no such thing")
    call wait_for_ranks()
    if (this_rank == 0) call delete_file(name, error)
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
    call wait_for_ranks()
  end subroutine read_bytes

  subroutine write_bytes(bytes)
    character(len=1), intent(in) :: bytes(:)
    integer :: unit
    call wait_for_ranks()
    if (this_rank == 0) then
      open (newunit=unit, file=name, access="stream", form="unformatted", action="write", status="replace")
      write (unit) bytes
      close (unit)
    end if
    call wait_for_ranks()
  end subroutine write_bytes

end program test_sealed_file
