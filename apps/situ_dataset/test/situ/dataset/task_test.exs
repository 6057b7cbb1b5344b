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

  test "what JSON cannot say is what the option means" do
    config = %{"mode" => "exact", "gain" => 2, "drop" => "Secret", "least" => 1}
    assert {:ok, opts} = Task.options(@schema, config)
    assert opts[:mode] == :exact and opts[:drop] == ["Secret"] and opts[:stream] == "Audio"
    assert opts[:gain] === 2.0 and opts[:least] === 1.0
    assert {:ok, [{_, _}, {:quality, 80} | _]} = Task.options(@schema, %{"quality" => 80.0})
    assert {:error, %{code: :bad_option}} = Task.options(@schema, %{"quality" => 80.5})
  end

  property "any configuration is options that fit the schema, or an error" do
    value =
      one_of([integer(), float(), boolean(), text(), list(text()), one_of([nil, %{}, "exact"])])

    name = one_of(["stream", "quality", "gain", "mode", "drop", "least", text()])

    forall pairs <- list({name, value}) do
      case Task.options(@schema, Map.new(pairs)) do
        {:ok, opts} ->
          assert opts[:quality] in 1..100 and opts[:mode] in [:fast, :exact]
          assert is_float(opts[:gain]) and is_list(opts[:drop])

        {:error, %Situ.Error{code: code}} ->
          assert code in [:unknown_option, :bad_option]
      end
    end
  end

  test "names that nobody knows make no atoms" do
    unknown = fn n ->
      {:error, %{code: :unknown_option}} = Task.options(@schema, %{"strange#{n}" => "mode#{n}"})
    end

    unknown.(0)
    before = :erlang.system_info(:atom_count)
    for n <- 1..1_000, do: unknown.(n)
    # Other tests run beside this one.
    assert :erlang.system_info(:atom_count) - before < 500
  end

  test "a task is found by its name, and a near name is told" do
    assert Enum.map(Task.all(), & &1.task().name) |> Enum.sort() ==
             Enum.map(Task.all(), & &1.task().name)

    assert {:ok, Task.Statistics} = Task.fetch("statistics")

    assert {:error, %{code: :no_task, fix: "did you mean drop-streams?"}} =
             Task.fetch("drop-stream")
  end

  test "every task has a name, says what it is about, and documents its options" do
    for module <- Task.all(), task = module.task() do
      assert task.name =~ ~r/\A[a-z][a-z-]*\z/ and task.about != ""
      for {name, spec} <- task.options, do: assert(is_binary(spec[:doc]), "#{task.name}: #{name}")
    end
  end
end
