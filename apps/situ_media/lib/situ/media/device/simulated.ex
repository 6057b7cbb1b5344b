defmodule Situ.Media.Device.Simulated do
  @moduledoc false
  # A camera and a microphone that replay a file in real time, so that pipelines can be tested without hardware.
  @behaviour Situ.Media.Device
  alias Situ.Media.{Device, FFmpeg}

  @impl true
  def list, do: []

  @impl true
  def capture(address, kind, opts) when kind in [:camera, :microphone] do
    {path, loop} =
      case String.split(address, "?once") do
        [path, ""] -> {path, []}
        _ -> {address, ~w(-stream_loop -1)}
      end

    if File.regular?(path) do
      args = ["-re" | loop] ++ (opts[:args] || []) ++ FFmpeg.local_file(path)
      {:ok, %{args: args, clock: :start, ends?: loop == []}}
    else
      Device.driver_error(path, :no_file, "cannot simulate a device: the file does not exist")
    end
  end
end
