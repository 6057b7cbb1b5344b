defmodule Situ.RuntimeGuidesTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  @moduletag :capture_log
  @folder Path.expand("../../../docs/guides", __DIR__)

  for guide <-
        ~w(your-first-pipeline writing-a-component choosing-a-delivery-policy when-things-fail
            simulation genstage) do
    test "every snippet of #{guide} runs in order" do
      path = Path.join(@folder, unquote(guide) <> ".md")
      capture_io(fn -> assert Situ.Test.GuideRunner.run_blocks(path) > 0 end)
    end
  end
end
