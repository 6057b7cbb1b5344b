defmodule Situ.Codec do
  @moduledoc """
  How a struct is laid out as bytes, for stores and wires.

  A module that defines a struct implements this behaviour when Erlang's external term format would be a poor fit
  (images, audio: a small header and raw samples that are read back as a sub-binary, without a copy). Everything
  else needs nothing: it is stored as an external term.

  `decode/1` meets untrusted bytes: it checks every length and answers `{:error, reason}`, never raises, and makes no
  atoms from what it reads.
  """

  @typedoc "A span of numeric samples folded together: its time, extremes, last value and how many there were."
  @type point ::
          {Situ.Time.t(), min :: number(), max :: number(), last :: number(),
           count :: pos_integer()}

  @doc "A short, stable name written into files (`\"situ.image\"`)."
  @callback codec_name() :: String.t()

  @doc "Header and payload. Large binaries should stay whole elements of the list, so that nothing is copied."
  @callback encode(struct()) :: iodata()

  @doc "The struct from its bytes; large payloads are sub-binaries of `bytes`."
  @callback decode(bytes :: binary()) :: {:ok, struct()} | {:error, term()}

  @doc """
  The numeric signal inside one message, in time order, for min/max/last/count pyramids (audio waveforms). Times are
  absolute nanoseconds; a point may stand for many samples.
  """
  @callback points(struct(), originating_time :: Situ.Time.t()) :: [point()]

  @optional_callbacks points: 2

  @doc "Returns whether `module` is a known module (`Situ.KnownModules`) that implements this behaviour."
  @spec implemented_by?(module()) :: boolean()
  def implemented_by?(module) when is_atom(module) do
    Situ.KnownModules.load?(module) and function_exported?(module, :codec_name, 0) and
      function_exported?(module, :encode, 1) and function_exported?(module, :decode, 1)
  end
end
