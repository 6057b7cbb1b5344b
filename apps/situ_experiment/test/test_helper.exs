# A busy machine may deliver an expected message late. A missing message still fails the test.
ExUnit.start(assert_receive_timeout: 30_000, timeout: 120_000)
