defmodule Situ.Live.Rendered do
  @moduledoc false
  # The result of `~H`: the template's static strings and the values between them.
  #
  # `n + 1` strings enclose `n` values. A value is an escaped string, another `Rendered`, a
  # `Situ.Live.Comprehension`, a `Situ.Live.Island`, or `:unchanged` (since the last render).
  # `fingerprint` identifies the template; `root?` is true if the template is exactly one tag.
  @enforce_keys [:static, :dynamic, :fingerprint]
  defstruct [:static, :dynamic, :fingerprint, root?: false]

  @type value ::
          binary() | t() | Situ.Live.Comprehension.t() | Situ.Live.Island.t() | :unchanged
  @type t :: %__MODULE__{
          static: [binary()],
          dynamic: [value()],
          fingerprint: integer(),
          root?: boolean()
        }
end
