defmodule Situ.Store.S3.DoctestsTest do
  use ExUnit.Case, async: true
  doctest Situ.Store.S3.Address
  doctest Situ.Store.S3.Mirror
  doctest Situ.Store.S3.MirrorFile
  doctest Situ.Store.S3.Retention
end
