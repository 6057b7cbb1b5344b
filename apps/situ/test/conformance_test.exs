defmodule Situ.ConformanceTest do
  # Runs one ExUnit test per conformance file of this app. `bin/conformance` prints the cases one by one and also runs
  # the slow files (situ_running, pipeline_lifecycle, delivery_policies ...).
  use ExUnit.Case, async: true

  Code.require_file("../../../test/conformance/conformance.exs", __DIR__)

  @moduletag :capture_log
  @moduletag timeout: 600_000

  @areas ~w(intervals interpolators fuse zip_merge windows sampling operators statistics generators parallel)

  for file <- Situ.Conformance.files(),
      area = Path.basename(file, ".json"),
      area in @areas or area in ~w(situ_model situ_rules situ_forms) do
    test "every case of #{area} passes" do
      verdicts = Situ.Conformance.verdicts(unquote(file))
      assert verdicts != []
      assert [] == for({id, {:fail, expected, got}} <- verdicts, do: {id, expected, got})
    end
  end

  test "every case passes under random schedules" do
    for file <- Situ.Conformance.files(),
        area = Path.basename(file, ".json"),
        area in @areas,
        {case, :pass, _us} <- Situ.Conformance.timed_verdicts(file) do
      judge = fn ->
        assert {case["id"], :pass} == {case["id"], Situ.Conformance.verdict(area, case)}
      end

      Situ.Simulation.check(judge, schedules: 4)
    end
  end

  # The system test tries more mutations, and the slow areas.
  test "every case fails when its expectation is changed" do
    for file <- Situ.Conformance.files(), Path.basename(file, ".json") in @areas do
      assert {file, []} == {file, Situ.Conformance.Mutation.survivors(file, 4)}
    end
  end

  @tag :tmp_dir
  test "a file that cannot be read or a malformed case fails with a reason", %{tmp_dir: dir} do
    verdict = fn text ->
      file = Path.join(dir, "fuse.json")
      File.write!(file, text)
      [{_id, verdict} | _] = Situ.Conformance.verdicts(file)
      verdict
    end

    assert {:fail, _, "it is not JSON"} = verdict.("{")
    assert {:fail, _, "it has no list of \"cases\""} = verdict.(~s({"cases": 1}))
    assert {:fail, "a case with an \"op\"", _} = verdict.(~s({"cases": [1]}))
    assert {:fail, _, "neither"} = verdict.(~s({"cases": [{"op": "join"}]}))

    assert {:fail, "params as" <> _, _} =
             verdict.(~s({"cases": [{"op": "join", "params": 1, "expect": 1}]}))

    assert {:fail, 1, _} =
             verdict.(
               ~s({"cases": [{"op": "join.chain", "params": {"order": "x"}, "expect": 1}]})
             )

    assert {:fail, 1, "this form of pair cannot be read" <> _} =
             verdict.(~s({"cases": [{"op": "pair", "inputs": [{}], "expect": 1}]}))

    assert {:fail, 1, "no rule reads fuse.other with the parameters [\"x\"]" <> _} =
             verdict.(~s({"cases": [{"op": "fuse.other", "params": {"x": 1}, "expect": 1}]}))

    assert {:fail, _, "it cannot be read" <> _} =
             dir |> Situ.Conformance.verdicts() |> hd() |> elem(1)
  end

  test "an unknown part of a case fails with its text, whatever the case expects" do
    verdict = fn op, params, expect ->
      inputs = [%{"messages" => [%{"t_ms" => 0, "v" => 1}]}]
      case = Map.merge(%{"op" => op, "params" => params, "inputs" => inputs}, expect)
      Situ.Conformance.verdict(nil, case)
    end

    for expect <- [%{"expect" => 1}, %{"expect_error" => "argument_error"}] do
      assert {:fail, _, "the selector of a window is not understood: \"median\""} =
               verdict.("window.index", %{"from" => 0, "to" => 0, "selector" => "median"}, expect)

      assert {:fail, _, "a formula is not understood: \"v plus one\""} =
               verdict.("select", %{"function" => "v plus one"}, expect)
    end

    assert {:fail, _, "no rule reads these parts of the expectation: {\"colour\", \"blue\"}"} =
             verdict.("first", %{}, %{"expect" => %{"colour" => "blue"}})
  end

  test "reads intervals, ranges and comparisons as texts" do
    alias Situ.Conformance.Text

    assert {-10_000_000, true, 20_000_000, false} = Text.interval!("[-10, 20 ms)")
    assert {:unbounded, false, 0, true} = Text.interval!("past")
    assert [0, 1, 2] = Text.range("0..2")

    for {text, number, holds?} <- [
          {">= 3", 3, true},
          {"fewer than 3 messages", 3, false},
          {"between 1 and 3", 2, true},
          {"1..3", 4, false},
          {">= 3_changed", 3, nil}
        ],
        do: assert({text, Text.compare(text, number)} == {text, holds?})
  end

  test "takes the area from the file's name or derives it from the operation" do
    assert Situ.Conformance.area("a/situ_zip_merge.json") == "zip_merge"
    assert Situ.Conformance.area("b/pipeline_lifecycle.json") == "pipeline_lifecycle"
    assert Situ.Conformance.area("runtime_rules.json") == nil
    assert [] == for({id, {:not_applicable, _}} <- rules(), do: id)
  end

  defp rules do
    file = Enum.find(Situ.Conformance.files(), &(Path.basename(&1) == "situ_rules.json"))
    Situ.Conformance.verdicts(file)
  end
end
