defmodule Situ.CLI.RunTest do
  use ExUnit.Case
  import ExUnit.CaptureIO
  alias Situ.Store

  @moduletag :tmp_dir

  setup %{tmp_dir: folder} do
    # Modules of files are global, so each test has its own.
    name = "Knocks#{System.unique_integer([:positive])}"
    file = Path.join(folder, "knocks.exs")

    File.write!(file, """
    defmodule #{name} do
      use Situ.Pipeline,
        options: [
          count: [type: :pos_integer, default: 5, doc: "How many numbers."],
          gap: [type: :time_ns, default: Situ.Time.ms(1), doc: "The time between them."],
          input: [type: {:optional, :string}, default: nil, doc: "A file."]
        ]

      def build(p, opts) do
        p
        |> Situ.from_enumerable(1..opts[:count], every: opts[:gap], name: "Number")
        |> Situ.map(&(&1 * 2))
        |> Situ.each(& &1)
      end
    end
    """)

    %{script: file, name: name}
  end

  defp run(argv) do
    me = self()

    errors =
      capture_io(:stderr, fn ->
        output = capture_io(fn -> send(me, {:status, Situ.CLI.run(["run" | argv])}) end)
        send(me, {:output, output})
      end)

    assert_received {:status, status}
    assert_received {:output, output}
    {status, output, errors}
  end

  test "runs a module with options, and records its named streams", %{
    script: file,
    tmp_dir: folder
  } do
    recording = Path.join(folder, "recordings/first")
    set = ["--set", "count=40", "--set", "gap=10ms"]
    {0, output, errors} = run([file, "--speed", "max", "--record", recording] ++ set)
    assert errors =~ "is running; Ctrl-C stops it"
    assert output =~ ~r/1\d\d messages handled/
    assert output =~ "Recorded 1 stream in #{recording}.0000"

    {:ok, store} = Store.open(recording)
    assert [%{name: "Number", count: 40}] = Store.streams(store)
    [first, second | _] = Enum.map(Store.messages(store, "Number"), & &1.originating_time)
    assert second - first == 10_000_000
  end

  test "--all records streams without a name, too", %{script: file, tmp_dir: folder} do
    recording = Path.join(folder, "all")
    {0, _, _} = run([file, "--record", recording, "--all"])
    {:ok, store} = Store.open(recording)
    assert Enum.map(Store.streams(store), & &1.name) |> Enum.sort() == ["Each", "Map", "Number"]
  end

  test "--json prints one object", %{script: file, name: name} do
    {0, output, ""} = run([file, "--json"])
    assert {:ok, %{"name" => ^name, "messages" => 10, "dropped" => 0}} = Situ.JSON.decode(output)
  end

  test "--options lists the options without running", %{script: file} do
    {0, output, ""} = run([file, "--options"])
    assert output =~ "gap: The time between them. (default 1.00 ms)"
  end

  test "--duration stops a pipeline without an end", %{tmp_dir: folder} do
    file = Path.join(folder, "endless.exs")
    File.write!(file, "fn p -> Situ.timer(p, every: Situ.Time.ms(1), name: \"Ticks\") end")
    {0, output, _} = run([file, "--duration", "20ms", "--record", Path.join(folder, "ticks")])
    assert output =~ "endless ended after"
    {:ok, store} = Store.open(Path.join(folder, "ticks"))
    assert Store.closed?(store)
  end

  test "a file may run its pipelines itself", %{tmp_dir: folder} do
    file = Path.join(folder, "script.exs")
    File.write!(file, "Situ.Pipeline.run(&Situ.from_enumerable(&1, 1..3, every: 1))")
    assert {0, output, ""} = run([file])
    assert output =~ "ended after"
    assert {1, "", error} = run([file, "--record", Path.join(folder, "x")])
    assert error =~ "defines no pipeline for these options"
  end

  describe "errors say what to do" do
    test "for options", %{script: file} do
      assert {1, "", error} = run([file, "--set", "cuont=3"])
      assert error =~ ~s(unknown option "cuont") and error =~ "did you mean count?"
      assert {1, "", error} = run([file, "--set", "count=many"])
      assert error =~ "option :count must be a positive integer"
      assert {2, "", error} = run([file, "--speed", "fast"])
      assert error =~ "--speed takes a number above 0, or max"
      assert {2, "", error} = run([file, "--record", "recordings/"])
      assert error =~ "--record takes FOLDER/NAME"
    end

    test "for files", %{script: file, tmp_dir: folder, name: name} do
      assert {1, "", error} = run([Path.join(folder, "missing.exs")])
      assert error =~ "cannot read" and error =~ "no such file"
      assert {1, "", error} = run([folder])
      assert error =~ "is not a project" and error =~ "situ new"
      assert {1, "", error} = run([file, "--module", "Other"])
      assert error =~ "defines no pipeline Other" and error =~ "It defines: #{name}"

      broken = Path.join(folder, "broken.exs")
      File.write!(broken, "x = 1 +")
      assert {1, "", error} = run([broken])
      assert error =~ "broken.exs cannot be compiled"

      File.write!(broken, "a = 1\nraise \"no camera\"\n")
      assert {1, "", error} = run([broken])
      assert error =~ "failed: ** (RuntimeError) no camera" and error =~ "broken.exs:2"
    end

    test "for a pipeline that fails", %{tmp_dir: folder} do
      file = Path.join(folder, "fails.exs")

      File.write!(
        file,
        "fn p -> p |> Situ.from_enumerable([0], every: 1) |> Situ.map(&(1 / &1)) end"
      )

      ExUnit.CaptureLog.capture_log(fn ->
        assert {1, "", error} = run([file])
        assert error =~ "Map failed" and error =~ "fails.exs:1"
      end)
    end

    test "for several pipelines in one file", %{tmp_dir: folder} do
      file = Path.join(folder, "two.exs")
      unique = System.unique_integer([:positive])

      module = fn name ->
        """
        defmodule #{name}#{unique} do
          use Situ.Pipeline
          def build(p, _), do: Situ.from_enumerable(p, [1], every: 1)
        end
        """
      end

      File.write!(file, module.("A") <> module.("B"))
      assert {1, "", error} = run([file])
      assert error =~ "choose one with --module: A#{unique}, B#{unique}"
      assert {0, _, _} = run([file, "--module", "B#{unique}"])
    end
  end
end
