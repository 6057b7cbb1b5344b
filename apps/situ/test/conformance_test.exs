defmodule Situ.ConformanceTest do
  # One ExUnit test per conformance file that this app answers for; `bin/conformance` prints them case by case.
  use ExUnit.Case, async: true

  Code.require_file("../../../test/conformance/conformance.exs", __DIR__)

  @moduletag :capture_log

  @areas ~w(intervals interpolators fuse zip_merge windows sampling operators statistics generators parallel)

  for file <- Situ.Conformance.files(), area = Path.basename(file, ".json"), area in @areas do
    test "every case of #{area} holds" do
      verdicts = Situ.Conformance.verdicts(unquote(file))
      assert verdicts != []
      assert [] == for({id, {:fail, expected, got}} <- verdicts, do: {id, expected, got})
    end
  end
end
