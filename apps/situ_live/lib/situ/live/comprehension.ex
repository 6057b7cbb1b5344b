defmodule Situ.Live.Comprehension do
  @moduledoc false
  # The result of `:for`: one template for all entries, and `{key, values}` for each. An entry
  # that keeps its key also keeps its DOM node when it moves. `stream` is set for a
  # `Situ.Live.Stream`.
  @enforce_keys [:static, :entries, :fingerprint]
  defstruct [:static, :entries, :fingerprint, stream: nil]

  @type t :: %__MODULE__{
          static: [binary()],
          entries: [{term(), [Situ.Live.Rendered.value()]}],
          fingerprint: integer(),
          stream: nil | list()
        }
end
