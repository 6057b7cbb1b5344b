defmodule Situ.Pipeline.Directory do
  @moduledoc false
  # The pipelines of this node: every one is entered under its label; one whose `name:` is an atom is registered under that as well.
  alias Situ.Error

  @doc false
  def registry, do: {Registry, keys: :duplicate, name: __MODULE__}

  @doc "The calling process is a pipeline from now on."
  @spec enter(Situ.Pipeline.Settings.t()) :: :ok | {:error, Error.t()}
  def enter(settings) do
    with :ok <- register(settings.registered) do
      {:ok, _} = Registry.register(__MODULE__, settings.name, nil)
      :ok
    end
  end

  defp register(nil), do: :ok

  defp register(name) do
    Process.register(self(), name)
    :ok
  rescue
    ArgumentError -> {:error, taken(name)}
  end

  @doc "Label and process of each, in the order of labels."
  @spec all() :: [{String.t(), pid()}]
  def all do
    Registry.select(__MODULE__, [{{:"$1", :"$2", :_}, [], [{{:"$1", :"$2"}}]}]) |> Enum.sort()
  end

  @doc "The pipeline with this label. Raises `Situ.Error` (`:ambiguous_name`) when there are several."
  @spec whereis(String.t()) :: pid() | nil
  def whereis(label) do
    case Registry.lookup(__MODULE__, label) do
      [] -> nil
      [{pid, _}] -> pid
      several -> raise ambiguous(label, length(several))
    end
  end

  defp taken(name) do
    Error.new(:name_taken, "the name #{inspect(name)} cannot be taken",
      why: "another process has it, or it is reserved",
      fix: "give the pipeline another name:"
    )
  end

  defp ambiguous(label, n) do
    Error.new(:ambiguous_name, "#{n} pipelines are called #{inspect(label)}",
      fix: "use the pid (Situ.pipelines/0 lists them), or give them names of their own"
    )
  end
end
