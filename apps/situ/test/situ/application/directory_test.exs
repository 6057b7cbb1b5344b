defmodule Situ.Application.DirectoryTest do
  # Looks up pipelines by name.
  use ExUnit.Case, async: true

  alias Situ.{Pipeline, Time}

  describe "names" do
    defp ticking(name) do
      Pipeline.start(fn p -> Situ.timer(p, every: Time.ms(1), name: "Ticks") end,
        pipeline: [name: name]
      )
    end

    test "registers an atom, which every function accepts" do
      assert {:ok, p} = ticking(:manners_lobby)
      assert Process.whereis(:manners_lobby) == p
      assert Pipeline.info(:manners_lobby).pipeline == "manners_lobby"
      assert {:error, %{code: :name_taken}} = ticking(:manners_lobby)
      assert_raise Situ.Error, fn -> Pipeline.new(name: :manners_lobby) end
      assert {:ok, _} = Pipeline.stop(:manners_lobby)
      assert {:ok, _} = ticking(:manners_lobby)
      assert {:ok, _} = Pipeline.stop(:manners_lobby)
    end

    test "finds a pipeline by its label if the label is unique" do
      label = "Lobby #{System.unique_integer()}"
      assert {:ok, p} = ticking(label)
      assert [%{pid: ^p, state: state}] = Enum.filter(Situ.Pipeline.list(), &(&1.name == label))
      assert state in [:starting, :running]
      assert Pipeline.clock(label) == Pipeline.clock(p)
      assert {:ok, other} = ticking(label)
      error = assert_raise Situ.Error, fn -> Pipeline.info(label) end
      assert error.code == :ambiguous_name
      assert {:ok, _} = Pipeline.stop(other)
      assert {:ok, _} = Pipeline.stop(label)
      assert {:error, %{code: :not_running}} = Pipeline.stop(label)
    end

    test "a snapshot lists the processes" do
      {:ok, p} = ticking("Pids")
      [{"Ticks", pid, _, _}] = Supervisor.which_children(p)
      assert Pipeline.clock(p)
      assert [%{pid: text}] = Pipeline.info(p).processes
      assert text == inspect(pid)
      assert {:ok, _} = Pipeline.stop(p)
    end
  end
end
