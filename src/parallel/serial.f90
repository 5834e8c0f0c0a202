!> One process alone: what would go to others comes back
submodule(gimp_ranks) gimp_ranks_serial
  implicit none(type, external)
contains

  module procedure start_ranks
    backend = "serial"
  end procedure start_ranks

  module procedure end_ranks
    stop code, quiet=.true.
  end procedure end_ranks

  module procedure end_all_ranks
    stop code, quiet=.true.
  end procedure end_all_ranks

  module procedure wait_for_ranks
  end procedure wait_for_ranks

  module procedure share_words
  end procedure share_words

  module procedure gather_words
    all(:, 0) = mine
  end procedure gather_words

  module procedure sum_words
  end procedure sum_words

  module procedure largest_words
  end procedure largest_words

  module procedure words_before
    words = 0
  end procedure words_before

  module procedure reduce_sums
  end procedure reduce_sums

  module procedure exchange_words
    from_count = to_count
    from = to
  end procedure exchange_words

  module procedure open_channel
    allocate (channel%out(channel%to_first(size(channel%to) + 1) - 1), channel%in(channel%from_first(size(channel%from) + 1) - 1))
    allocate (channel%to_words(size(channel%to)), channel%from_words(size(channel%from)), source=0_i8)
  end procedure open_channel

  module procedure close_channel
    if (associated(channel%out)) deallocate (channel%out, channel%in)
    channel = channel_t()
  end procedure close_channel

  module procedure start_exchange
    integer :: k
    do k = 1, size(channel%to)
      channel%in(channel%from_first(k):channel%from_first(k) + channel%to_words(k) - 1) = &
        channel%out(channel%to_first(k):channel%to_first(k) + channel%to_words(k) - 1)
    end do
    channel%from_words = channel%to_words
  end procedure start_exchange

  module procedure finish_exchange
  end procedure finish_exchange

end submodule gimp_ranks_serial
