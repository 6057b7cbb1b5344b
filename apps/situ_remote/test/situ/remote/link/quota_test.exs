defmodule Situ.Remote.Link.QuotaTest do
  use ExUnit.Case, async: true
  doctest Situ.Remote.Link.Quota
end
