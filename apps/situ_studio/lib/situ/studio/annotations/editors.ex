defmodule Situ.Studio.Annotations.Editors do
  @moduledoc false
  # Finds the running editors of a studio's annotation layers by the store and the stream that they edit.

  @registry Situ.Studio.Registry

  @doc "Returns the name under which the editor of a stream is registered."
  @spec editor_name(String.t(), Path.t(), String.t()) :: GenServer.name()
  def editor_name(studio, store, stream),
    do: {:via, Registry, {@registry, editor_key(studio, store, stream)}}

  defp editor_key(studio, store, stream), do: {studio, :annotation, Path.expand(store), stream}

  @doc "Returns the running editor of a stream, or `nil`."
  @spec find_editor(String.t(), Path.t(), String.t()) :: pid() | nil
  def find_editor(studio, store, stream) do
    case Registry.lookup(@registry, editor_key(studio, store, stream)) do
      [{pid, _}] -> pid
      [] -> nil
    end
  end

  @doc "Returns the running editors of all streams of some stores."
  @spec list_editors(String.t(), [Path.t()]) :: [pid()]
  def list_editors(studio, stores) do
    for store <- stores,
        pid <-
          Registry.select(@registry, [
            {{{studio, :annotation, Path.expand(store), :_}, :"$1", :_}, [], [:"$1"]}
          ]),
        do: pid
  end
end
