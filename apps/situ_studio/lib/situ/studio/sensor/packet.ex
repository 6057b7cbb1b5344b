defmodule Situ.Studio.Sensor.Packet do
  @moduledoc false
  # Parses the data that a sensor's page sends. The bytes are untrusted, so anything invalid is `:error`.

  @doc "Returns the page's time (ms since 1970) and the values to emit."
  @callback parse(binary()) :: {float(), [{atom(), term()}]} | :error
end
