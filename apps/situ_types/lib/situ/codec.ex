defmodule Situ.Codec do
  @moduledoc """
  Encodes structs as bytes for stores and network protocols.

  A module that defines a struct implements this behaviour if Erlang's external term format is a poor fit. Images and
  audio, for example, have a small header and raw samples, which are read back as a sub-binary without a copy. All
  other data is stored in the external term format and needs no codec.

  `decode/1` receives untrusted bytes. It must check every length, return `{:error, reason}` instead of raising, and
  never create atoms from its input.

      defmodule Weight do
        @behaviour Situ.Codec
        defstruct [:grams]

        @impl true
        def codec_name, do: "example.weight"

        @impl true
        def encode(weight), do: <<weight.grams::64>>

        @impl true
        def decode(<<grams::64>>), do: {:ok, %Weight{grams: grams}}
        def decode(_bytes), do: {:error, :bad_weight}
      end
  """

  @typedoc "A summary of consecutive samples: start time, minimum, maximum, last value and sample count."
  @type point ::
          {Situ.Time.t(), min :: number(), max :: number(), last :: number(),
           count :: pos_integer()}

  @doc "Returns a short, stable name that is written to files (`\"situ.image\"`)."
  @callback codec_name() :: String.t()

  @doc "Returns header and payload. Large binaries should be separate list elements so that they are not copied."
  @callback encode(struct()) :: iodata()

  @doc "Decodes a struct from `bytes`; large payloads are sub-binaries of `bytes`."
  @callback decode(bytes :: binary()) :: {:ok, struct()} | {:error, term()}

  @doc """
  Returns the numeric signal in one message, in time order, for summary pyramids (such as audio waveforms). Times are
  absolute nanoseconds. A point may summarize many samples.
  """
  @callback points(struct(), originating_time :: Situ.Time.t()) :: [point()]

  @optional_callbacks points: 2

  @doc """
  Returns whether `module` implements this behaviour. Only modules that are loaded or that a loaded application lists
  are found, because names may come from files.

      iex> Situ.Codec.implemented_by?(Situ.Image)
      true
      iex> Situ.Codec.implemented_by?(Situ.Point3)
      false
  """
  @spec implemented_by?(module()) :: boolean()
  def implemented_by?(module) when is_atom(module) do
    Situ.KnownModules.ensure_loaded?(module) and function_exported?(module, :codec_name, 0) and
      function_exported?(module, :encode, 1) and function_exported?(module, :decode, 1)
  end
end
