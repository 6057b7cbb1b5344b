defmodule Situ.Media.Recording.Servers do
  @moduledoc false
  # Runs one process for the images and one for the audio of every media file that is currently read. They are started
  # on the first request and end when idle, so that an opened file does not have to be closed.

  alias Situ.Error

  @registry Situ.Media.Recording.Registry
  @supervisor Situ.Media.Recording.Supervisor

  @spec child_specs() :: [Supervisor.child_spec() | {module(), keyword()}]
  def child_specs do
    [
      {Registry, keys: :unique, name: @registry},
      {DynamicSupervisor, name: @supervisor, strategy: :one_for_one}
    ]
  end

  @doc "Sends a request to the process of `module` that reads this recording, and starts it if necessary."
  @spec call_server(module(), map(), term()) :: term()
  def call_server(module, recording, question, tries \\ 3) do
    with {:ok, pid} <- find_or_start(module, recording) do
      try do
        GenServer.call(pid, question, :infinity)
      catch
        # The process ended before it received the request, so try again.
        :exit, {reason, _} when reason in [:normal, :noproc] and tries > 1 ->
          call_server(module, recording, question, tries - 1)
      end
    end
  end

  defp find_or_start(module, recording) do
    key = {module, recording.path, recording.version, recording.print}

    # Unlike a lookup, this ignores a process that has just ended.
    case Registry.whereis_name({@registry, key}) do
      :undefined -> start_server(module, recording, key)
      pid -> {:ok, pid}
    end
  end

  defp start_server(module, recording, key) do
    spec = %{
      id: module,
      start:
        {GenServer, :start_link, [module, recording, [name: {:via, Registry, {@registry, key}}]]},
      restart: :temporary
    }

    case DynamicSupervisor.start_child(@supervisor, spec) do
      {:ok, pid} -> {:ok, pid}
      {:error, {:already_started, pid}} -> {:ok, pid}
      {:error, %Error{} = error} -> {:error, error}
      {:error, {:shutdown, %Error{} = error}} -> {:error, error}
    end
  end
end
