# What must come may take its time on a busy machine; what does not come fails all the same.
ExUnit.start(assert_receive_timeout: 30_000, timeout: 120_000)
