defmodule Situ.Live.TokenRateLimitTest do
  use ExUnit.Case, async: true
  alias Situ.Live.TokenRateLimit

  test "twenty wrong tokens within two minutes block only that address and server" do
    {server, peer, other} = {make_ref(), {10, 0, 0, 1}, {10, 0, 0, 2}}
    for i <- 1..20, do: TokenRateLimit.count_wrong_token(server, peer, i * 1_000)
    assert TokenRateLimit.too_many?(server, peer, 21_000)
    refute TokenRateLimit.too_many?(server, other, 21_000)
    refute TokenRateLimit.too_many?(make_ref(), peer, 21_000)
    assert TokenRateLimit.too_many?(server, peer, 119_000)
    refute TokenRateLimit.too_many?(server, peer, 120_000)
  end
end
