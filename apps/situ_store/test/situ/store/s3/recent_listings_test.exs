defmodule Situ.Store.S3.RecentListingsTest do
  use ExUnit.Case, async: true
  alias Situ.Store.S3.RecentListings

  test "a listing is remembered for some seconds, and an error is not" do
    address = "s3://bucket/#{System.unique_integer()}"
    failed = fn -> {:error, Situ.Error.new(:unreachable, "no")} end
    assert {:error, _} = RecentListings.fetch(address, failed, 0)
    assert {:ok, ["a"]} = RecentListings.fetch(address, fn -> {:ok, ["a"]} end, 0)
    assert {:ok, ["a"]} = RecentListings.fetch(address, failed, 4_999)
    assert {:ok, ["b"]} = RecentListings.fetch(address, fn -> {:ok, ["b"]} end, 5_000)
  end
end
