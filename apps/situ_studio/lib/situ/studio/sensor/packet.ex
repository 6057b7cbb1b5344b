defmodule Situ.Studio.Sensor.Packet do
  @moduledoc false
  # How a sensor reads what its page sends: bytes of the outside, so whatever is none of it is `:error`.

  @doc "The page's time, ms since 1970, and what is to be put out."
  @callback parse(binary()) :: {float(), [{atom(), term()}]} | :error
end
