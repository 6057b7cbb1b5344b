defmodule Situ.Media.Device.Input do
  @moduledoc false
  # All other input devices of FFmpeg. `Situ.Media.Device` lists their names.
  @behaviour Situ.Media.Device

  @impl true
  def list, do: []

  @impl true
  def capture("lavfi:" <> graph, _kind, opts),
    do: {:ok, %{args: ~w(-re -f lavfi) ++ (opts[:args] || []) ++ ["-i", graph], clock: :arrival}}

  def capture("x11grab:" <> display, _kind, opts) do
    size =
      if opts[:size], do: ["-video_size", Enum.join(Tuple.to_list(opts[:size]), "x")], else: []

    rate = ["-framerate", to_string(opts[:rate] || 15)]

    {:ok,
     %{
       args: ~w(-f x11grab) ++ size ++ rate ++ (opts[:args] || []) ++ ["-i", display],
       clock: :arrival
     }}
  end

  def capture("input:" <> name, _kind, opts),
    do: {:ok, %{args: (opts[:args] || []) ++ ["-i", name], clock: :arrival}}
end
