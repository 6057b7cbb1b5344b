defmodule Situ.Dataset.TaskTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Dataset.Task

  doctest Situ.Dataset.Task

  @schema [
    stream: [type: :string, default: "Audio"],
    quality: [type: {:integer, 1, 100}, default: 90],
    gain: [type: :float, default: 1.0],
    mode: [type: {:in, [:fast, :exact]}, default: :fast],
    drop: [type: {:list, :string}, default: []],
    least: [type: {:optional, :float}]
  ]

  test "converts JSON values to the types of the options" do
    config = %{"mode" => "exact", "gain" => 2, "drop" => "Secret", "least" => 1}
    assert {:ok, opts} = Task.parse_options(@schema, config)
    assert opts[:mode] == :exact and opts[:drop] == ["Secret"] and opts[:stream] == "Audio"
    assert opts[:gain] === 2.0 and opts[:least] === 1.0
    assert {:ok, [{_, _}, {:quality, 80} | _]} = Task.parse_options(@schema, %{"quality" => 80.0})
    assert {:error, %{code: :bad_option}} = Task.parse_options(@schema, %{"quality" => 80.5})
  end

  property "accepts any configuration as valid options, or returns an error" do
    value =
      one_of([
        integer(),
        float(),
        boolean(),
        ascii_text(),
        list(ascii_text()),
        one_of([nil, %{}, "exact"])
      ])

    name = one_of(["stream", "quality", "gain", "mode", "drop", "least", ascii_text()])

    forall pairs <- list({name, value}) do
      case Task.parse_options(@schema, Map.new(pairs)) do
        {:ok, opts} ->
          assert opts[:quality] in 1..100 and opts[:mode] in [:fast, :exact]
          assert is_float(opts[:gain]) and is_list(opts[:drop])

        {:error, %Situ.Error{code: code}} ->
          assert code in [:unknown_option, :bad_option]
      end
    end
  end

  test "unknown names create no atoms" do
    unknown = fn n ->
      {:error, %{code: :unknown_option}} =
        Task.parse_options(@schema, %{"strange#{n}" => "mode#{n}"})
    end

    unknown.(0)
    before = :erlang.system_info(:atom_count)
    for n <- 1..1_000, do: unknown.(n)
    # Other tests run in parallel.
    assert :erlang.system_info(:atom_count) - before < 500
  end

  test "finds a task by its name, and suggests a similar one" do
    assert Enum.map(Task.list_tasks(), & &1.task().name) |> Enum.sort() ==
             Enum.map(Task.list_tasks(), & &1.task().name)

    assert {:ok, Task.Statistics} = Task.fetch_task("statistics")

    assert {:error, %{code: :no_task, fix: "did you mean drop-streams?"}} =
             Task.fetch_task("drop-stream")
  end

  test "every task has a name, a summary and documented options" do
    for module <- Task.list_tasks(), task = module.task() do
      assert task.name =~ ~r/\A[a-z][a-z-]*\z/ and task.about != ""
      for {name, spec} <- task.options, do: assert(is_binary(spec[:doc]), "#{task.name}: #{name}")
    end
  end
end
