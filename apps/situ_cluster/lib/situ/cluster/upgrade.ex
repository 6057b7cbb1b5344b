defmodule Situ.Cluster.Upgrade do
  @moduledoc false
  # Loads new code in a cluster while its pipelines are running. One node after the other loads
  # the code and restarts its parts from a checkpoint taken for this purpose. As when a part
  # moves, no message is lost or repeated.
  #
  #     Situ.Cluster.upgrade([{MyLips, File.read!("ebin/Elixir.MyLips.beam")}])
  #     Situ.Cluster.upgrade([MyLips])          # the code of this node
  #
  # The new components must accept the saved states of the old ones, and the graph must be split
  # into the same parts and streams. If a node cannot meet these conditions, it and all previous
  # nodes return to the old code, and the error gives the reason. Deploy a pipeline with another
  # graph under another name.
  #
  # An upgrade replaces only modules. To install a new release, call `drain/2` for a node, restart
  # it, and continue with the next node.
  alias Situ.Cluster.{Agent, PartStarter, Runner}
  alias Situ.Error

  @wait_ms 120_000

  @type code :: [{module(), binary()}]

  @doc "Returns the code of modules: from this node's files, or as given in `{module, beam}`."
  @spec collect_code([module() | {module(), binary()}]) :: {:ok, code()} | {:error, Error.t()}
  def collect_code(modules) do
    Enum.reduce_while(modules, {:ok, []}, fn
      {module, beam}, {:ok, code} when is_atom(module) and is_binary(beam) ->
        {:cont, {:ok, [{module, beam} | code]}}

      module, {:ok, code} when is_atom(module) ->
        case :code.get_object_code(module) do
          {_, beam, _} -> {:cont, {:ok, [{module, beam} | code]}}
          :error -> {:halt, {:error, no_code_error(module)}}
        end
    end)
  end

  defp no_code_error(module) do
    Error.new(:no_code, "this node has no file with the code of #{inspect(module)}",
      fix: "give {module, beam}, as returned by Code.compile_file/1"
    )
  end

  @doc "Upgrades all members, this node last. Returns the upgraded nodes."
  @spec upgrade_nodes(code()) :: {:ok, [node()]} | {:error, Error.t()}
  def upgrade_nodes(code) do
    nodes = Enum.sort_by(Map.keys(Agent.info().members), &{&1 == node(), &1})
    upgrade_rest(nodes, code, [])
  end

  defp upgrade_rest([], _code, upgraded),
    do: {:ok, for({node, _} <- Enum.reverse(upgraded), do: node)}

  defp upgrade_rest([node | rest], code, upgraded) do
    case call_node(node, :take, [code]) do
      {:ok, previous} ->
        upgrade_rest(rest, code, [{node, previous} | upgraded])

      {:error, error} ->
        for {node, previous} <- upgraded, do: call_node(node, :take, [previous])

        {:error,
         %{
           error
           | what: "the upgrade failed on #{node}, so all nodes keep the old code: #{error.what}"
         }}
    end
  end

  defp call_node(node, function, args) do
    :erpc.call(node, __MODULE__, function, args, @wait_ms)
  catch
    :error, {:erpc, reason} -> {:error, lost_node_error(node, reason)}
    :exit, reason -> {:error, lost_node_error(node, reason)}
  end

  defp lost_node_error(node, reason),
    do: Error.new(:unreachable, "#{node} is lost: #{inspect(reason, limit: 5)}")

  @doc false
  @spec take(code()) :: {:ok, code()} | {:error, Error.t()}
  def take(code) do
    previous =
      for {module, _} <- code, {^module, beam} <- [current_code(module)], do: {module, beam}

    with :ok <- load_modules(code),
         :ok <- same_plans(),
         :ok <- restart_parts() do
      remember_code(code)
      {:ok, previous}
    else
      {:error, error} ->
        _ = load_modules(previous)
        _ = restart_parts()
        {:error, error}
    end
  end

  # Code from an earlier upgrade is not in any file.
  defp current_code(module) do
    case :persistent_term.get({__MODULE__, module}, nil) do
      nil -> with {module, beam, _} <- :code.get_object_code(module), do: {module, beam}
      beam -> {module, beam}
    end
  end

  defp remember_code(code),
    do: for({module, beam} <- code, do: :persistent_term.put({__MODULE__, module}, beam))

  defp load_modules([]), do: :ok

  defp load_modules([{module, beam} | rest]) do
    with {:purge, true} <- {:purge, :code.soft_purge(module)},
         {:module, _} <- :code.load_binary(module, ~c"upgrade", beam) do
      load_modules(rest)
    else
      {:purge, false} ->
        {:error,
         Error.new(
           :old_code_in_use,
           "a process is still running the code of #{inspect(module)} from before the last upgrade",
           fix: "wait until it has ended, or restart that node"
         )}

      {:error, reason} ->
        {:error, Error.new(:bad_code, "#{inspect(module)} cannot be loaded: #{inspect(reason)}")}
    end
  end

  defp same_plans do
    Enum.find_value(Agent.info().deployments, :ok, fn deployment ->
      with {:ok, plan} <- PartStarter.build_plan(deployment),
           true <- Agent.find_plan(deployment.name) == plan do
        nil
      else
        {:error, error} -> {:error, error}
        false -> {:error, other_plan_error(deployment.name)}
      end
    end)
  end

  defp other_plan_error(name) do
    Error.new(:other_plan, "the new code splits #{name} into different parts or streams",
      why: "running parts are connected by their current streams",
      fix: "deploy it under another name:, and stop this one"
    )
  end

  defp restart_parts do
    runners =
      for d <- Agent.info().deployments, {_, runner} <- Agent.list_runners(d.name), do: runner

    Enum.reduce_while(runners, :ok, fn runner, :ok ->
      case Runner.restart_part(runner) do
        :ok -> {:cont, :ok}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end
end
