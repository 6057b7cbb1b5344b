locals_without_parens = [attr: 2, attr: 3, slot: 1, slot: 2, slot: 3]

[
  line_length: 98,
  inputs: ["{mix,.formatter}.exs", "{config,lib,test}/**/*.{ex,exs}"],
  locals_without_parens: locals_without_parens,
  export: [locals_without_parens: locals_without_parens]
]
